"""The alpha-order rule: first order as far as zeroth order vouches for it.

H. J. T. Suh, M. Simchowitz, K. Zhang, R. Tedrake, "Do Differentiable Simulators Give Better Policy Gradients?",
ICML 2022.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.both_orders import Mix, both_orders, combine, variance_of_mean
from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.mixed import inverse_variance
from tog_mjx.gradients.perturbation import Size
from tog_mjx.running.errors import InputError


def bernstein_radius(terms: Float[Array, "N n"], confidence: Size) -> Float[Array, ""]:
    """How far the mean of N independent vectors z_i may be from its expectation.

    Bernstein's inequality for vectors [n] of covariance trace v, no farther than R from their expectation, is
    P(|mean - expectation| >= eps) <= (n + 1) exp(-N eps^2 / (2 v + 2 R eps / 3)). With the right-hand side equal to
    1 - confidence and l = log((n + 1) / (1 - confidence)), this is a quadratic equation for eps, solved by

      eps = r + sqrt(r^2 + 2 l v / N),  r = l R / (3 N).

    Here v is the trace of the sample covariance and R the largest |z_i - mean| of the samples. The true ones are not
    known, and zeroth-order terms have no bound: a rule of the inequality's form, no guarantee. It is zero for samples
    that are all equal, as where none of them has crossed a jump.

    Units: of the terms [N, n].
    Gradient: none is meant to be taken of an error.
    Source: Bernstein's inequality for vectors, as in Suh et al., ICML 2022.
    """
    samples, n = terms.shape
    level = jnp.log((n + 1) / (1 - confidence))
    reach = jnp.linalg.norm(terms - terms.mean(0), axis=1).max()
    drift = level * reach / (3 * samples)
    return drift + jnp.sqrt(drift**2 + 2 * level * variance_of_mean(terms))


def alpha_order_mix(
    objective: Objective, sigma: Size, samples: int, confidence: Size, threshold: Size
) -> Callable[[Key[Array, ""], Float[Array, " n"]], tuple[Float[Array, ""], Mix]]:
    """As `alpha_order`, with the whole record of the mix, a `Mix`, in place of its gradient [n].

    Raises:
      InputError: as `alpha_order`.

    Units: J's per unit of u; of variances, that squared.
    Gradient: what it returns is that of `alpha_order`, at a kink and across a jump too.
    Source: as `alpha_order`.
    """
    if not isinstance(confidence, jax.core.Tracer) and not 0 < float(confidence) < 1:
        raise InputError(f"confidence is {confidence}: it is a probability between 0 and 1, both excluded")
    if not isinstance(threshold, jax.core.Tracer) and not float(threshold) > 0:
        raise InputError(f"threshold is {threshold}: an error to be accepted is positive")
    draw = both_orders(objective, sigma, samples)

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Mix]:
        terms = draw(key, u)
        alpha = inverse_variance(terms)
        radius = bernstein_radius(terms.zeroth, confidence)
        apart = jnp.linalg.norm(terms.first.mean(0) - terms.zeroth.mean(0))
        limit = jnp.maximum(0.0, (threshold - radius) / apart)
        return terms.cost, combine(terms, jnp.where(alpha * apart + radius > threshold, limit, alpha))

    return estimate


def alpha_order(objective: Objective, sigma: Size, samples: int, confidence: Size, threshold: Size) -> Estimator:
    """alpha g1 + (1 - alpha) g0 [n], with the largest weight alpha that zeroth order vouches for.

    alpha is that of `mixed` unless alpha |g1 - g0| + eps > gamma, with eps the `bernstein_radius` of g0. Then it is
    max(0, (gamma - eps) / |g1 - g0|). So the estimate is within gamma of the gradient of J_sigma(u) = E J(u + w)
    wherever g0 is within eps < gamma of it: g1 may be biased. A gamma below eps leaves zeroth order alone, an infinite
    one is `mixed`. Costs are those of `mixed`, and so are the variance and the bias where the weight is.

    Args:
      objective: differentiable almost everywhere. It may jump.
      sigma: standard deviation of w, in the units of u; positive.
      samples: N, at least 2.
      confidence: of the radius, between 0 and 1.
      threshold: gamma, the error accepted, in the units of the gradient; positive, and may be infinite.

    Raises:
      InputError: for a setting known to be outside its range.

    Units: J's per unit of u.
    Gradient: what it returns is an estimate of J_sigma's, at a kink as `mixed`, across a jump within gamma of it where
      the radius holds.
    Source: Suh et al., ICML 2022.
    """
    record = alpha_order_mix(objective, sigma, samples, confidence, threshold)

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        cost, found = record(key, u)
        return cost, found.gradient

    return estimate
