"""Many motions of a problem at once, every few time steps."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.objective import objective
from tog_mjx.engines.program import Motion
from tog_mjx.engines.simulator import precision
from tog_mjx.problems.problem import Problem
from tog_mjx.running.batches import map_points
from tog_mjx.running.types import Scalar


class Motions(NamedTuple):
    """N motions at `time` [k] (s): box [N, k, 6] and fingers [N, k, F, 4], as in a `Motion`.

    The initial state and the last one are among them. `costs` [N] are J.
    """

    time: np.ndarray
    box: np.ndarray
    fingers: np.ndarray
    costs: np.ndarray


def simulate_many(
    problem: Problem,
    engine: str,
    points: Float[np.ndarray, "N n"],
    every: int = 1,
    report: Callable[[int], None] = lambda _: None,
) -> Motions:
    """The motions of a planar scene under each row of variables, every `every` time steps."""
    kept = np.union1d(np.arange(0, problem.steps + 1, every), problem.steps)
    with precision(engine):
        J = objective(problem, engine)

        def motion(x: jax.Array) -> tuple[Motion, Scalar]:
            whole, cost = J.with_motion(x)
            return jax.tree.map(lambda leaf: leaf[kept], whole), cost

        found, costs = map_points(jax.vmap(motion), points, report)
    return Motions(found.time[0], found.box, found.fingers, costs)
