"""Zeroth and first order mixed by inverse variance."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.both_orders import Mix, Terms, both_orders, combine, variance_of_mean
from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.perturbation import Size


def inverse_variance(terms: Terms) -> Float[Array, ""]:
    """The weight V0 / (V0 + V1) of first order; 1 where both variances are zero."""
    zeroth, total = variance_of_mean(terms.zeroth), variance_of_mean(terms.zeroth) + variance_of_mean(terms.first)
    return jnp.where(total == 0, 1.0, zeroth / jnp.where(total == 0, 1.0, total))


def mix(
    objective: Objective, sigma: Size, samples: int
) -> Callable[[Key[Array, ""], Float[Array, " n"]], tuple[Float[Array, ""], Mix]]:
    """As `mixed`, with the whole record of the mix, a `Mix`, in place of its gradient [n].

    Raises:
      InputError: as `mixed`.

    Units: J's per unit of u; of variances, that squared.
    Gradient: what it returns is that of `mixed`, at a kink and across a jump too.
    Source: as `mixed`.
    """
    draw = both_orders(objective, sigma, samples)

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Mix]:
        terms = draw(key, u)
        return terms.cost, combine(terms, inverse_variance(terms))

    return estimate


def mixed(objective: Objective, sigma: Size, samples: int) -> Estimator:
    """alpha g1 + (1 - alpha) g0 [n], with alpha = V0 / (V0 + V1); N gradients, which bring N costs, and J(u).

    g0 is `zeroth_order` with its baseline and g1 `first_order` under the same key, V0 and V1 their variances as `Mix`
    has them. Where J jumps it shares the bias of first order, and more of it the smaller V1. Elsewhere its bias is
    O(1 / N), for alpha is found on the same samples.

    The weight is the best of all only if g0 and g1 are uncorrelated. With their covariance C, a trace as well, the
    variance at a given alpha is alpha^2 V1 + (1 - alpha)^2 V0 + 2 alpha (1 - alpha) C: never above the larger of V0
    and V1, and below the smaller if C is zero. On J = 1/2 u^T A u + b^T u, C = sigma^2 [(tr A)^2 / 2 + |A|_F^2] / N is
    at least V1: no mix is better there than first order alone.

    Args:
      objective: differentiable almost everywhere. A derivative that is not finite makes the estimate not finite.
      sigma: standard deviation of w, in the units of u; positive.
      samples: N, at least 2.

    Raises:
      InputError: for a sigma known not to be positive and finite, or fewer than two samples.

    Units: J's per unit of u.
    Gradient: what it returns is an estimate of J_sigma's: at a kink biased by O(1 / N), across a jump as first order.
    Source: weights by inverse variance, Suh et al., ICML 2022; bias and variance: own derivation.
    """
    record = mix(objective, sigma, samples)

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        cost, found = record(key, u)
        return cost, found.gradient

    return estimate
