"""Many motions of a task at once, every few time steps."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from tog_mjx.engines import make_simulator, precision
from tog_mjx.engines.rollout import trajectory
from tog_mjx.paper.tasks import Task
from tog_mjx.running.batches import map_points


class Motions(NamedTuple):
    """States of N motions at `time` [k] (s): box [N, k, 6] and fingers [N, k, F, 4], as in a `Trajectory`.

    The initial state and the last one are among them. `costs` [N] are J, at the last one.
    """

    time: np.ndarray
    box: np.ndarray
    fingers: np.ndarray
    costs: np.ndarray


def simulate_many(
    task: Task,
    simulator: str,
    setpoints: Float[np.ndarray, "N n"],
    every: int = 1,
    report: Callable[[int], None] = lambda _: None,
) -> Motions:
    """The motions under each row of setpoints [2F], every `every` time steps."""
    kept = np.union1d(np.arange(0, task.horizon, every), task.horizon - 1)
    with precision(simulator):
        engine = make_simulator(simulator, task.scene)

        def motion(u):
            whole = trajectory(task, engine, u)
            return jax.tree.map(lambda leaf: leaf[kept], whole), task.cost(whole.box[-1])

        states, costs = map_points(jax.vmap(motion), setpoints, report)
    return Motions(states.time[0], states.box, states.fingers, costs)
