"""The cost and its gradient over a task's window: J at the setpoints that the window's points expand to.

Points are in the window's coordinates (x, z) in m, and run along x first.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.engines import SIMULATORS, make_simulator, precision
from tog_mjx.engines.objective import final_cost
from tog_mjx.gradients import exact_batch
from tog_mjx.paper.tasks import Task
from tog_mjx.running.batches import map_kept
from tog_mjx.running.digests import program_digest, scene_digest
from tog_mjx.running.types import Scalar, Vector


class Landscape(NamedTuple):
    """Costs [size, size] over `points` [size * size, 2]; row i has the i-th z, column j the j-th x."""

    points: np.ndarray
    costs: np.ndarray


class GradientField(NamedTuple):
    """Gradients of J [N, 2] at `points` [N, 2]."""

    points: np.ndarray
    gradients: np.ndarray


def landscape(
    task: Task, simulator: str, size: int, folder: Path, report: Callable[[int], None] = lambda _: None
) -> Landscape:
    """`size` x `size` points, the window's edges included. Kept in `folder`; a killed one is continued.

    `report` is called with the number of points done.
    """
    points = grid(task, size)
    with precision(simulator):
        cost = jax.vmap(_cost(task, simulator))
        path = folder / f"landscape_{size}.npz"
        settings = _settings(task, simulator, "costs")
        costs = map_kept(cost, points, path, settings, report, SIMULATORS[simulator].CHUNK)
    return Landscape(points, costs.reshape(size, size))


def gradient_field(
    task: Task, simulator: str, size: int, folder: Path, report: Callable[[int], None] = lambda _: None
) -> GradientField:
    """At the centres of `size` x `size` cells of the window. Kept in `folder`; a killed one is continued."""
    points = grid(task, size, centred=True)
    with precision(simulator):
        gradient = exact_batch(_cost(task, simulator))
        path = folder / f"gradient_field_{size}.npz"
        settings = _settings(task, simulator, "gradients")
        gradients = map_kept(
            lambda batch: gradient(batch)[1], points, path, settings, report, SIMULATORS[simulator].CHUNK
        )
    return GradientField(points, gradients)


def grid(task: Task, size: int, centred: bool = False) -> Float[np.ndarray, "N 2"]:
    """`size` x `size` points of the window, its edges included, or the centres of as many cells."""
    fractions = (np.arange(size) + 0.5) / size if centred else np.linspace(0, 1, size)
    x, z = (low + (high - low) * fractions for low, high in task.window)
    return np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)


def _cost(task: Task, simulator: str) -> Callable[[Vector], Scalar]:
    """J of a point of the window."""
    engine = make_simulator(simulator, task.scene)
    return lambda point: final_cost(task, engine, jnp.asarray(task.expand(point)))


def _settings(task: Task, simulator: str, what: str) -> dict[str, Any]:
    """All that the values depend on, but the number of points."""
    return {
        "what": what,
        "simulator": simulator,
        "task": task.name,
        "window": task.window,
        "steps": task.steps,
        "scene": scene_digest(task.scene.model),
        "program": program_digest(__name__),
    }
