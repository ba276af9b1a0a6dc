"""Which iterate of a descent is the best where each update draws other starts: held-out ones judge.

A recorded cost is that of its own draw, and the least of many the luckiest. So a few iterates are simulated again, all
from the same starts, which no update has seen.
"""

import jax
import numpy as np

from tog_mjx.engines.objective import Objective
from tog_mjx.solving.descent import Descent

JUDGED, SHARE = 11, 0.1
"""Iterates that are judged, evenly spaced from the first to the last, and the part of a budget that they share."""
KEY = 2**31 - 1
"""Of the starts; those of the updates are split from key 0."""


def judge(found: Descent, J: Objective, budget: int | float) -> Descent:
    """The record with `held_out`, from at most so many evaluations of J but one an iterate at the least."""
    chosen = np.unique(np.linspace(0, found.iterations, JUDGED).round().astype(int))
    starts, costs = max(1, int(budget / len(chosen))), np.full(len(found.costs), np.nan)
    for i in chosen:
        cost = float(J.each(found.setpoints[i], jax.random.key(KEY), starts).mean())
        costs[i] = cost if np.isfinite(cost) else np.inf
    return found._replace(held_out=costs)
