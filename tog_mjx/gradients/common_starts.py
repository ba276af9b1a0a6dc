"""Estimators of a cost that draws its starts: new ones at each call, and the same for all evaluations of that call."""

import functools
from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Objective


def common_starts(estimator: Callable[..., Callable], objective: Callable, *settings: Any, **named: Any) -> Callable:
    """`estimator(objective, *settings, **named)` for a J(u, key) whose key draws starts: `exact`, `zeroth_order`,
    `both_orders`, or any other.

    A call's key is split, into that of the starts and that of the perturbations. Costs that are subtracted are of the
    same starts, so how much starts differ from one another does not count (common random numbers), and the mean over
    keys is that of the estimator on the mean cost.

    Units: those of the estimator; u is [n].
    Gradient: what it returns is that of the estimator, at a kink and across a jump too.
    Source: own; common random numbers.
    """

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> Any:
        starts, perturbations = jax.random.split(key)
        on_these: Objective = functools.partial(objective, key=starts)
        return estimator(on_these, *settings, **named)(perturbations, u)

    return estimate
