"""Central differences at one step, as an estimator."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.perturbation import Size, check_positive


def central_differences(objective: Objective, step: Size) -> Estimator:
    """[J(u + h e_i) - J(u - h e_i)] / (2 h) along each axis; 2 n + 1 evaluations, one batch.

    Deterministic. Its error is (h^2 / 6) d^3 J / du_i^3 + O(h^4), none for a quadratic, and rounding of about
    |J| eps / h. Across a jump of J by D it is D / (2 h). The other `central_differences`, of
    `tog_mjx.gradients.settled`, chooses h.

    Args:
      objective: need not be differentiable.
      step: h, in the units of u; positive.

    Raises:
      InputError: for a step known not to be positive and finite.
    """
    check_positive("step", step, "a difference needs a positive step")

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        del key
        shifts = step * jnp.eye(u.size, dtype=u.dtype)
        costs = jax.vmap(objective)(jnp.concatenate([u[None], u + shifts, u - shifts]))
        ahead, behind = jnp.split(costs[1:], 2)
        return costs[0], (ahead - behind) / (2 * step)

    return estimate
