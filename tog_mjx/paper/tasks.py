"""The paper's two tasks: what to reach, from where, in which time, and Table I.

Setpoints u [2F] are finger-major: (x_des, z_des) of finger 1, then of finger 2 [m]. With K knots they change over time:
u [K * 2F] holds the setpoints of the first knot, then those of the second, ...; knots are evenly spaced from the first
time step to the last, and between two of them setpoints change linearly. Costs take the box's last state [6].
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from tog_mjx.mjcf.scene import Scene, load_scene
from tog_mjx.running.errors import InputError, near, require_whole
from tog_mjx.running.types import Box, Scalar, Setpoints, Vector


class Rule(NamedTuple):
    """A row of Table I: step size alpha, number of updates, and for the stochastic rule sigma [m]."""

    step_size: float
    iterations: int
    sigma: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """A scene, a horizon and a cost, with Table I's settings. Compared and hashed by identity.

    `horizon` is the number of states T, the initial one included: T - 1 time steps. `cost` maps the box's last state
    [6] to J, and `goal` is a pose (x, z, theta) at which J is 0. `window` is the landscape's
    ((x_min, x_max), (z_min, z_max)) [m], and `expand` maps its points [2] to setpoints [K * 2F].
    """

    name: str
    scene: Scene
    horizon: int
    cost: Callable[[Box], Scalar]
    goal: tuple[float, float, float]
    exact: Rule
    stochastic: Rule
    window: tuple[tuple[float, float], tuple[float, float]]
    expand: Callable[[Vector], Setpoints]
    knots: int = 1

    @property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Box [6] and fingers [F, 4], where the scene starts."""
        return self.scene.start

    @property
    def initial_guess(self) -> np.ndarray:
        """The setpoints u [2F] from which the paper descends: those with which the scene starts."""
        return np.tile(self.scene.initial_guess, self.knots)


def flip_cost(box: Box) -> Scalar:
    """J = x^2 + theta^2: upright at the origin."""
    return box[0] ** 2 + box[2] ** 2


def grasp_cost(box: Box) -> Scalar:
    """J = (z - 1)^2 + 0.1 (x^2 + theta^2 + vx^2 + vz^2 + omega^2): at rest, level, at a height of 1 m."""
    x, z, theta, vx, vz, omega = box
    return (z - 1) ** 2 + 0.1 * (x**2 + theta**2 + vx**2 + vz**2 + omega**2)


@functools.cache
def flip() -> Task:
    """Box flip (paper, section II): one finger tips a box upright and to the origin."""
    return Task(
        name="flip",
        scene=load_scene("flip"),
        horizon=600,
        cost=flip_cost,
        goal=(0.0, 0.25, 0.0),
        exact=Rule(step_size=0.1, iterations=5),
        stochastic=Rule(step_size=0.1, iterations=10, sigma=0.5),
        window=((-0.5, 0.5), (0.0, 1.0)),
        expand=jnp.asarray,
    )


@functools.cache
def grasp() -> Task:
    """Box grasp (paper, section II): two fingers lift a box to 1 m. Its landscape shows the symmetric setpoints."""
    return Task(
        name="grasp",
        scene=load_scene("grasp"),
        horizon=500,
        cost=grasp_cost,
        goal=(0.0, 1.0, 0.0),
        exact=Rule(step_size=0.5, iterations=100),
        stochastic=Rule(step_size=0.5, iterations=1000, sigma=0.1),
        window=((-1.0, 1.0), (0.0, 2.0)),
        expand=_mirrored,
    )


TASKS = {"flip": flip, "grasp": grasp}


def get_task(task: str | Task, knots: int | None = None) -> Task:
    """The task of that name; a Task is returned as it is. With `knots`, its setpoints change over time.

    Equal calls return the same Task.

    Raises:
      InputError: for an unknown name, or a number of knots that is not positive or more than the time steps.
    """
    if not isinstance(task, Task):
        if task not in list(TASKS):
            raise InputError(f"task {task!r} is unknown; choose from {', '.join(TASKS)}{near(task, TASKS)}")
        task = TASKS[task]()
    if knots is None or require_whole("knots", knots, 1, task.horizon - 1) == task.knots:
        return task
    return _with_knots(task, int(knots))


@functools.cache
def _with_knots(task: Task, knots: int) -> Task:
    if task.knots != 1:
        raise InputError(f"task {task.name} has {task.knots} knots already; start from the one with constant setpoints")
    return dataclasses.replace(task, knots=knots, expand=functools.partial(_repeated, task.expand, knots))


def _mirrored(point: Vector) -> Setpoints:
    """Of both fingers, from those of the first one."""
    return jnp.array([point[0], point[1], -point[0], point[1]])


def _repeated(expand: Callable[[Vector], Setpoints], knots: int, point: Vector) -> Setpoints:
    return jnp.tile(jnp.asarray(expand(point)), knots)
