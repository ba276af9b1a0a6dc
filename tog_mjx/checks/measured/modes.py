"""Forward against reverse mode, and implicit against native differentiation: they must agree."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.agreement import relative
from tog_mjx.checks.measured.recorded import Motion, Simulation
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.gradients.reversible import unless_refused

SAME, SAME_SINGLE = 1e-6, 1e-2
"""Relative difference of derivatives that are the same but for rounding, in float64 and in float32: 1e-16 and 1e-7,
grown 1e10 and 1e5 times. More is a term that one of them lacks; small here, it may be large at the next point."""
_REMEDY = "use forward mode; of mjx.step, differentiate tog.step"
_BRANCH = "a jnp.where passes on the NaN of the branch that it does not take: make that branch finite"


def reverse(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    x: Float[np.ndarray, " n"],
    directions: Float[np.ndarray, "n k"],
    slopes: Float[np.ndarray, "m k"],
    compiled: Callable[[Callable], Callable] = jax.jit,
) -> Finding:
    """Reverse mode along a fixed random cotangent, against what forward mode found along directions."""
    weights = np.random.default_rng(0).normal(size=len(slopes))
    found = unless_refused(compiled(jax.grad(lambda x: function(x) @ weights)), jnp.asarray(x))
    if found is None:
        sentence = (
            "reverse mode raises an error: there is a loop of unknown length (in stock mjx.step it is the solver)"
        )
        return Finding("reverse mode", Level.CARE, sentence, None, _REMEDY)
    if not np.isfinite(found).all():
        return Finding("reverse mode", Level.FAULT, "reverse mode gives NaN or infinity", None, f"{_REMEDY}; {_BRANCH}")
    error = relative(np.asarray(found) @ directions, weights @ slopes)
    sentence = f"forward and reverse mode differ by {error:.0e}"
    if error <= (SAME if jax.config.values["jax_enable_x64"] else SAME_SINGLE):
        return Finding("reverse mode", Level.FINE, sentence, error)
    return Finding("reverse mode", Level.FAULT, sentence, error, "one is wrong: 'agreement' judges forward mode")


def differentiation(simulation: Simulation, motion: Motion) -> Finding:
    """Implicit against native differentiation, in forward mode."""
    scene = simulation.scene
    other = "native" if scene.differentiation == "implicit" else "implicit"
    found = simulation.differentiated(other)
    native, implicit = (found, motion) if other == "native" else (motion, found)
    level = Level.FAULT if other == "implicit" else Level.FINE
    remedy = "differentiate tog.step in place of mjx.step" if level else ""
    if not np.isfinite(native.slopes).all():
        sentence = (
            "stock mjx.step gives NaN, tog.step does not" if np.isfinite(implicit.slopes).all() else "both give NaN"
        )
        return Finding("differentiation", level, sentence, None, remedy)
    error = relative(native.slopes, implicit.slopes)
    sentence = f"stock mjx.step and tog.step give gradients that differ by {error:.0e}"
    if error <= SAME:
        return Finding("differentiation", Level.FINE, sentence, error)
    return Finding("differentiation", level, sentence, error, remedy)
