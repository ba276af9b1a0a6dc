"""Whether JAX differentiates a function in reverse mode: it refuses at a loop of unknown length."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

REFUSED = "Reverse-mode differentiation does not work"


def unless_refused(function: Callable, *args: Any) -> Any:
    """`function(*args)`, which differentiates in reverse mode; None where JAX refuses to."""
    try:
        return function(*args)
    except ValueError as refusal:
        if REFUSED not in str(refusal):
            raise
    return None


def is_reversible(function: Callable[[Float[Array, " n"]], Any], n: int) -> bool:
    """Of a function of n numbers to a number, which is traced, not compiled."""
    return unless_refused(jax.eval_shape, jax.grad(function), jnp.zeros(n)) is not None
