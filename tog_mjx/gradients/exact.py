"""The exact gradient, by automatic differentiation (the paper's equation 8)."""

from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective

FORWARD_LIMIT = 4
"""Up to this many variables forward mode compiles and runs faster than reverse mode through a long rollout."""


def exact(objective: Objective, mode: Literal["forward", "reverse"] | None = None) -> Estimator:
    """J and its derivative.

    Args:
      objective: differentiable in the chosen mode.
      mode: "forward" (time grows with n, memory does not grow with the horizon), "reverse" (the opposite), or None:
        forward for at most `FORWARD_LIMIT` variables.

    Units: of the gradient [n], J's per unit of u.
    Gradient: what it returns is JAX's: across a jump that of the side on which u is, at a kink as JAX has it (of a
      maximum or a clip, the mean of both sides).
    Source: the paper's equation 8.
    """

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        del key
        if mode == "reverse" or (mode is None and u.size > FORWARD_LIMIT):
            return jax.value_and_grad(objective)(u)
        along = jax.vmap(lambda direction: jax.jvp(objective, (u,), (direction,)), out_axes=(None, 0))
        return along(jnp.eye(u.size, dtype=u.dtype))

    return estimate


def exact_batch(
    objective: Objective,
) -> Callable[[Float[Array, "N n"]], tuple[Float[Array, " N"], Float[Array, "N n"]]]:
    """J and its derivative at many points at once, in forward mode.

    The directions are the outermost axis of the computation and the points the innermost one, along which a processor
    works on several numbers at a time: on the penalty simulator that takes half the time of a batch of gradients.

    Units: of costs [N] J's, of gradients [N, n] J's per unit of u.
    Gradient: what it returns is as that of `exact` at a jump and at a kink.
    Source: own.
    """
    values = jax.vmap(objective)

    def batch(points: Float[Array, "N n"]) -> tuple[Float[Array, " N"], Float[Array, "N n"]]:
        def along(direction: Float[Array, " n"]) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
            return jax.jvp(values, (points,), (jnp.broadcast_to(direction, points.shape),))

        costs, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(points.shape[1], dtype=points.dtype))
        return costs, slopes.T

    return batch
