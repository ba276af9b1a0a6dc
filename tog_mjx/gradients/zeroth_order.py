"""Randomised smoothing from costs alone: Gaussian perturbations, many evaluations, no derivative.

Y. Nesterov and V. Spokoiny, "Random Gradient-Free Minimization of Convex Functions", Found. Comput. Math. 17 (2017).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.perturbation import Size, check_samples, check_sigma, directions


def zeroth_order(
    objective: Objective, sigma: Size, samples: int, antithetic: bool = False, baseline: bool = True
) -> Estimator:
    """The mean [n] over N samples w ~ N(0, sigma^2 I) of [J(u + w) - b] w / sigma^2; N + 1 evaluations, one batch.

    Here b is J(u), or 0 without the baseline. The antithetic estimate is the mean over N pairs of
    [J(u + w) - J(u - w)] w / (2 sigma^2), in which b cancels: 2 N + 1 evaluations.

    Each is an unbiased estimate of the gradient of J_sigma(u) = E J(u + w), even where J jumps. As an estimate of the
    gradient of J its bias is zero for a quadratic and O(sigma^2) for a smooth J. For J = 1/2 u^T A u + b^T u, with
    g = A u + b and T = (tr A)^2 + 2 |A|_F^2, the trace of its covariance is

      with baseline: [(n + 1) |g|^2 + sigma^2 (n + 4) T / 4] / N,
      without:       the same and [n J^2 / sigma^2 + (n + 2) J tr A] / N, with J = J(u),
      antithetic:    (n + 1) |g|^2 / N, for even powers of w cancel.

    Args:
      objective: need not be differentiable, nor continuous.
      sigma: standard deviation of w, in the units of u; positive.
      samples: N, of perturbations, or of pairs of them.
      antithetic: evaluate each perturbation and its opposite.
      baseline: subtract J(u). Without effect on the antithetic estimate.

    Raises:
      InputError: for a sigma known not to be positive and finite, or no samples.

    Units: J's per unit of u.
    Gradient: what it returns is an estimate of J_sigma's, unbiased also across a jump and at a kink.
    Source: Nesterov and Spokoiny 2017.
    """
    check_sigma(sigma)
    check_samples(samples)

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        along = directions(key, u, samples)
        points = [u[None], u + sigma * along] + ([u - sigma * along] if antithetic else [])
        # J(u) in the same batch: where J is flat, differences are zero to the last bit.
        costs = jax.vmap(objective)(jnp.concatenate(points))
        cost, perturbed = costs[0], costs[1 : samples + 1]
        if antithetic:
            rise = (perturbed - costs[samples + 1 :]) / 2
        elif baseline:
            rise = perturbed - cost
        else:
            rise = perturbed
        return cost, (rise[:, None] * along / sigma).mean(0)

    return estimate
