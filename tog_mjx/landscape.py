"""The cost and its gradient over a task's window: J at the setpoints that the window's points expand to."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.gradients import exact
from tog_mjx.rollout import final_cost
from tog_mjx.simulators import make_simulator
from tog_mjx.tasks import Task
from tog_mjx.types import Scalar, Vector

CHUNK = 64
"""Points computed at a time."""


class Landscape(NamedTuple):
    """Costs [size, size] over `points` [size * size, 2], and gradients [a * a, 2] at the coarser `arrows` [a * a, 2].

    Points and gradients are in the window's coordinates (x, z), and run along x first.
    """

    points: np.ndarray
    costs: np.ndarray
    arrows: np.ndarray
    gradients: np.ndarray


def compute_landscape(
    task: Task, simulator: str, size: int, arrows: int, report: Callable[[int], None] = lambda _: None
) -> Landscape:
    """In float64. `report` is called with the number of points done, of size^2 + arrows^2."""
    with jax.enable_x64():
        engine = make_simulator(simulator, task.scene)

        def cost(point: Vector) -> Scalar:
            return final_cost(task, engine, task.expand(point))

        estimate = exact(cost, "forward")
        points, coarse = grid(task, size), grid(task, arrows, centred=True)
        costs = _map(cost, points, report)
        slopes = _map(
            lambda point: estimate(jax.random.key(0), point)[1], coarse, lambda done: report(len(points) + done)
        )
    return Landscape(points, costs.reshape(size, size), coarse, slopes)


def grid(task: Task, size: int, centred: bool = False) -> Float[np.ndarray, "N 2"]:
    """`size` x `size` points of the window, its edges included, or the centres of as many cells."""
    fractions = (np.arange(size) + 0.5) / size if centred else np.linspace(0, 1, size)
    x, z = (low + (high - low) * fractions for low, high in task.window)
    return np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)


def _map(function: Callable, points: np.ndarray, report: Callable[[int], None]) -> np.ndarray:
    """`function` of every point, in chunks of one shape."""
    run = jax.jit(jax.vmap(function))
    found = []
    for first in range(0, len(points), CHUNK):
        chunk = points[first : first + CHUNK]
        found.append(np.asarray(run(jnp.asarray(np.resize(chunk, (CHUNK, 2)))))[: len(chunk)])
        report(first + len(chunk))
    return np.concatenate(found)
