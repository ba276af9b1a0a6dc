"""Forward against reverse mode, and implicit against native differentiation: they must agree."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.agreement import relative
from tog_mjx.checks.measured.recorded import Motion, Simulation
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.checks.told.finding import Finding, Level

SAME, SAME_SINGLE = 1e-6, 1e-2
"""Relative difference of derivatives that are the same but for rounding, in float64 and in float32: 1e-16 and 1e-7,
grown 1e10 and 1e5 times. More is a term that one of them lacks; small here, it may be large at the next point."""
_REMEDY = "use forward mode; of mjx.step, differentiate tog.step"
_BRANCH = "a jnp.where passes on the NaN of the branch that it does not take: make that branch finite"
REFUSED = "Reverse-mode differentiation does not work"


def is_reversible(function: Callable[[Float[Array, " n"]], Any], n: int) -> bool:
    """Whether JAX differentiates a function of n numbers to a number in reverse mode; it is traced, not compiled."""
    try:
        jax.eval_shape(jax.grad(function), jnp.zeros(n))
    except ValueError as refusal:
        if REFUSED not in str(refusal):
            raise
        return False
    return True


def compare_modes(backward: Callable[[], Array], directions: np.ndarray, expected: Float[np.ndarray, " k"]) -> Finding:
    """The gradient [n] that `backward` returns, against what forward mode found along directions [n, k]."""
    try:
        found = np.asarray(backward())
    except ValueError as refusal:
        if REFUSED not in str(refusal):
            raise
        sentence = (
            "reverse mode raises an error: there is a loop of unknown length (in stock mjx.step it is the solver)"
        )
        return Finding("reverse mode", Level.CARE, sentence, None, _REMEDY)
    if not np.isfinite(found).all():
        return Finding("reverse mode", Level.FAULT, "reverse mode gives NaN or infinity", None, f"{_REMEDY}; {_BRANCH}")
    error = relative(found @ directions, expected)
    sentence = f"forward and reverse mode differ by {error:.0e}"
    if error <= (SAME if jax.config.values["jax_enable_x64"] else SAME_SINGLE):
        return Finding("reverse mode", Level.FINE, sentence, error)
    return Finding("reverse mode", Level.FAULT, sentence, error, "one is wrong: 'agreement' judges forward mode")


def reverse(simulation: Simulation, motion: Motion) -> Finding:
    """Reverse mode along a fixed random cotangent, against forward mode."""
    weights = np.random.default_rng(0).normal(size=motion.value.shape)
    gradient = compile_quickly(jax.grad(lambda x: simulation.value(x) @ weights))
    return compare_modes(
        lambda: gradient(jnp.zeros(simulation.scene.size)), simulation.directions, weights @ motion.slopes
    )


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
