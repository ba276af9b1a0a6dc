"""Randomised smoothing from derivatives: the mean of exact gradients at perturbed points.

H. J. T. Suh, M. Simchowitz, K. Zhang, R. Tedrake, "Do Differentiable Simulators Give Better Policy Gradients?",
ICML 2022.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.exact import exact
from tog_mjx.gradients.perturbation import Size, check_samples, check_sigma, directions


def first_order(objective: Objective, sigma: Size, samples: int) -> Estimator:
    """The mean [n] over N samples w ~ N(0, sigma^2 I) of grad J(u + w); N gradients and one evaluation, of J(u).

    For a continuous J, differentiable almost everywhere and of moderate growth, it is an unbiased estimate of the
    gradient of J_sigma(u) = E J(u + w). Where J jumps it is biased, whatever N: of a jump by D along one variable it
    misses D phi(d / sigma) / sigma, where d is the distance of u from the jump and phi the standard normal density.
    For J = 1/2 u^T A u + b^T u its mean is A u + b and the trace of its covariance sigma^2 |A|_F^2 / N.

    Args:
      objective: differentiable almost everywhere, in the mode that `exact` chooses for n.
      sigma: standard deviation of w, in the units of u; positive.
      samples: N.

    Raises:
      InputError: for a sigma known not to be positive and finite, or no samples.

    Units: J's per unit of u.
    Gradient: what it returns is an estimate of J_sigma's, unbiased at a kink and biased across a jump.
    Source: Suh et al., ICML 2022.
    """
    check_sigma(sigma)
    check_samples(samples)
    slopes = jax.vmap(exact(objective), (None, 0))

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        gradients = slopes(key, u + sigma * directions(key, u, samples))[1]
        return jnp.asarray(objective(u)), gradients.mean(0)

    return estimate
