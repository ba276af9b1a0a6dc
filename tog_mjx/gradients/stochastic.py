"""The paper's stochastic gradient: one random direction, two evaluations (the paper's equation 9)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.perturbation import Size, check_sigma


def stochastic(objective: Objective, sigma: Size, normalised: bool = False) -> Estimator:
    """[J(u + w) - J(u)] w [n] with w ~ N(0, sigma^2 I).

    Its mean is sigma^2 times the gradient of J smoothed by w. That factor is part of the paper's rule and of its step
    sizes.

    Args:
      objective: need not be differentiable.
      sigma: standard deviation of w, in the units of u; positive.
      normalised: divide by sigma^2, so that the mean is the smoothed gradient itself.

    Raises:
      InputError: for a sigma known not to be positive and finite.

    Units: J's times u's; where `normalised`, J's per unit of u.
    Gradient: what it returns is an estimate of the smoothed J's, also across a jump and at a kink.
    Source: the paper's equation 9.
    """
    check_sigma(sigma)
    scale = 1 / sigma**2 if normalised else 1.0

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        w = sigma * jax.random.normal(key, u.shape, u.dtype)
        # One after the other: compiled once, and J(u) to the last bit what it is alone.
        cost, perturbed = jax.lax.map(objective, jnp.stack([u, u + w]))
        return cost, scale * (perturbed - cost) * w

    return estimate
