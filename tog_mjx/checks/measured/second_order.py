"""Second derivatives: against differences of the gradient, symmetric, and the same in both modes."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.agreement import agreement, relative, sweep
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.gradients.reversible import is_reversible

SYMMETRIC = 1e-6
"""Relative to the Hessian. A derivative that is right is symmetric to rounding; a rule that leaves out how its own
answer moves is not, and Newton's method, or a Gauss-Newton step, then solves another problem."""
_NAME = "second order"
_REMEDY = "look for a custom_jvp whose rule returns what passed stop_gradient; of mjx.step differentiate tog.step"


def second_order(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]],
    x: Float[np.ndarray, " n"],
    directions: Float[np.ndarray, "n k"],
) -> Finding:
    """The Hessian of the outputs' fixed random sum, along the directions: `directions`^T H `directions` [k, k]."""
    point, across = jnp.asarray(x), jnp.asarray(directions)
    size = jax.eval_shape(function, point).shape[0]
    weights = jnp.asarray(np.random.default_rng(0).normal(size=size), point.dtype)

    def number(x: Array) -> Array:
        return function(x) @ weights

    def slopes(function: Callable, x: Array) -> Array:
        """Of a number [k], or of an array [., k], along each direction."""
        return jax.vmap(lambda d: jax.jvp(function, (x,), (d,))[1], in_axes=1, out_axes=-1)(across)

    forward = functools.partial(slopes, number)
    hessian = np.asarray(jax.jit(lambda x: slopes(forward, x))(point), float)
    batch = jax.jit(jax.vmap(forward))
    differences = sweep(lambda points: np.asarray(batch(jnp.asarray(points, point.dtype))), x, directions)
    judged = agreement(hessian, differences)
    judged = dataclasses.replace(judged, check=_NAME, sentence=f"of the gradient's own derivative: {judged.sentence}")
    if judged.level == Level.FAULT:
        return dataclasses.replace(judged, remedy=_REMEDY)
    asymmetry = relative(hessian, hessian.T)
    if asymmetry > SYMMETRIC:
        sentence = f"the Hessian differs from its transpose by {asymmetry:.0e}"
        return Finding(_NAME, Level.FAULT, sentence, asymmetry, _REMEDY)
    if is_reversible(number, x.size):
        backward = directions.T @ np.asarray(jax.jit(lambda x: slopes(jax.grad(number), x))(point), float)
        error = relative(backward, hessian)
        if not error <= SYMMETRIC:
            sentence = f"forward over forward and forward over reverse mode differ by {error:.0e}"
            return Finding(_NAME, Level.FAULT, sentence, error, _REMEDY)
    return judged
