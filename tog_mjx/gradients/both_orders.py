"""Zeroth and first order at the same perturbed points, and a mix of the two at a given weight."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Objective
from tog_mjx.gradients.exact import exact
from tog_mjx.gradients.perturbation import Size, check_samples, check_sigma, directions


class Terms(NamedTuple):
    """J(u) [], and the terms [N, n] whose means are the zeroth-order and the first-order estimate."""

    cost: Float[Array, ""]
    zeroth: Float[Array, "N n"]
    first: Float[Array, "N n"]


class Mix(NamedTuple):
    """A mixed gradient [n], the weight [] of first order in it, and variances [] of it and of what is mixed.

    Each variance is that of the mean of N terms: the trace of their sample covariance over N. That of the mix is of
    its own terms, at the weight found, and so knows how far the two orders are correlated.

    Units: of the gradient J's per unit of u; of variances, that squared.
    Gradient: that of `mixed` or `alpha_order`, which say what it is across a jump and at a kink.
    """

    gradient: Float[Array, " n"]
    alpha: Float[Array, ""]
    variance: Float[Array, ""]
    variance_zeroth: Float[Array, ""]
    variance_first: Float[Array, ""]


def both_orders(
    objective: Objective, sigma: Size, samples: int
) -> Callable[[Key[Array, ""], Float[Array, " n"]], Terms]:
    """[J(u + w) - J(u)] w / sigma^2 and grad J(u + w), at N >= 2 samples w.

    J is evaluated N + 1 times and differentiated N times. The two means are `zeroth_order` with its baseline and
    `first_order`, under the same key.

    Raises:
      InputError: for a sigma known not to be positive and finite, or fewer than two samples.
    """
    check_sigma(sigma)
    check_samples(samples, least=2)
    slopes = jax.vmap(exact(objective), (None, 0))

    def draw(key: Key[Array, ""], u: Float[Array, " n"]) -> Terms:
        along = directions(key, u, samples)
        costs, gradients = slopes(key, u + sigma * along)
        cost = jnp.asarray(objective(u))
        return Terms(cost, (costs - cost)[:, None] * along / sigma, gradients)

    return draw


def variance_of_mean(terms: Float[Array, "N n"]) -> Float[Array, ""]:
    """Trace of the sample covariance over N."""
    return terms.var(0, ddof=1).sum() / len(terms)


def combine(terms: Terms, alpha: Float[Array, ""]) -> Mix:
    """alpha of first order and 1 - alpha of zeroth order."""
    blend = alpha * terms.first + (1 - alpha) * terms.zeroth
    return Mix(blend.mean(0), alpha, *map(variance_of_mean, (blend, terms.zeroth, terms.first)))
