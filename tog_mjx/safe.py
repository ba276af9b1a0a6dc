"""Singular mathematics with a defined gradient, in one place."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def safe_norm(x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean norm over the last axis. At the zero vector it returns zero, and its gradient there is zero."""
    squared = jnp.sum(x * x, axis=-1)
    is_zero = squared == 0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def cos_sinc(squared: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """cos(a) and sin(a) / a from a^2, smooth at zero: there they are 1, with derivatives -1/2 and -1/6 in a^2."""
    is_small = squared < 1e-6
    angle = jnp.sqrt(jnp.where(is_small, 1.0, squared))
    # The first terms left out are below 1e-20.
    cos = 1 - squared / 2 + squared**2 / 24
    sinc = 1 - squared / 6 + squared**2 / 120
    return jnp.where(is_small, cos, jnp.cos(angle)), jnp.where(is_small, sinc, jnp.sin(angle) / angle)
