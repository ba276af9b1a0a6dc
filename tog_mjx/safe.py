"""Singular mathematics with a defined gradient, in one place."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float


def safe_norm(x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean norm over the last axis. At the zero vector it returns zero, and its gradient there is zero."""
    squared = jnp.sum(x * x, axis=-1)
    is_zero = squared == 0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def cos_sinc(squared: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """cos(a) and sin(a) / a from a^2, smooth at zero: there they are 1, with derivatives -1/2 and -1/6 in a^2."""
    # Below 1 by their series, whose first terms left out are below 1e-18: derivatives of the closed forms cancel there,
    # the second ones to 1e-16 / a^4.
    is_small = squared < 1
    small, angle = jnp.where(is_small, squared, 0.0), jnp.sqrt(jnp.where(is_small, 1.0, squared))
    cos, sinc = (
        functools.reduce(lambda rest, k: 1 - rest * small / (k * (k + 1)), range(last, 0, -2), jnp.ones_like(small))
        for last in (17, 18)
    )
    return jnp.where(is_small, cos, jnp.cos(angle)), jnp.where(is_small, sinc, jnp.sin(angle) / angle)
