"""The paper's two tasks: problems whose variables are setpoints, with Table I.

Setpoints u [2F] are finger-major: (x_des, z_des) of finger 1, then of finger 2 [m]. With K knots they change over time:
u [K * 2F] holds those of the first knot, then those of the second, ...; see `tog.Controls`.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from tog_mjx.paper import released as released  # Which makes it known as an engine.
from tog_mjx.problems import Plane, Problem, State
from tog_mjx.problems.library import LIBRARY, get_problem
from tog_mjx.running.errors import InputError
from tog_mjx.running.older_names import OlderAttribute
from tog_mjx.running.types import Scalar, Setpoints, Vector


class Rule(NamedTuple):
    """A row of Table I: step size alpha, number of updates, and for the stochastic rule sigma [m]."""

    step_size: float
    iterations: int
    sigma: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Task(Problem):
    """A problem of the paper, with Table I's settings. Compared and hashed by identity.

    `goal` is a pose (x, z, theta) at which J is 0, and `budget` the evaluation equivalents of one run of a study.
    `window` is the landscape's ((x_min, x_max), (z_min, z_max)) [m]; where `mirrored`, its points [2] are setpoints of
    the first finger, and the second is its mirror image.

    Raises:
      InputError: as `tog.Problem`.

    Units: m, rad, s; setpoints u [K * 2F] in m.
    Gradient: of J, as that of `tog.objective`.
    """

    goal: tuple[float, float, float]
    exact: Rule
    stochastic: Rule
    budget: int
    window: tuple[tuple[float, float], tuple[float, float]]
    mirrored: bool = False
    in_float64: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """The longer side of the window."""
        return max(high - low for low, high in self.window)

    @property
    def plane(self) -> Plane:
        """The landscape's, whose coordinates are those of its window."""
        axes = np.tile([[1.0, 0, -1, 0], [0, 1, 0, 1]] if self.mirrored else np.eye(2), self.knots)
        low, high = np.array(self.window).T
        return Plane(np.zeros(axes.shape[1]), axes, low, high, ("x (m)", "z (m)"))

    @property
    def initial_guess(self) -> np.ndarray:
        """The setpoints u [K * 2F] from which the paper descends: those with which the scene starts."""
        return self.x0

    def expand(self, point: Vector) -> Setpoints:
        """The setpoints [K * 2F] of a point of the window."""
        return self.plane.x(point)

    @OlderAttribute.of("steps + 1")
    def horizon(self) -> int:
        return self.steps + 1


def flip_cost(last: State) -> Scalar:
    """J = x^2 + theta^2: upright at the origin."""
    return last.joint("box_x") ** 2 + last.joint("box_theta") ** 2


def grasp_cost(last: State) -> Scalar:
    """J = (z - 1)^2 + 0.1 (x^2 + theta^2 + vx^2 + vz^2 + omega^2): at rest, level, at a height of 1 m."""
    x, z, theta = (last.joint(f"box_{name}") for name in ("x", "z", "theta"))
    vx, vz, omega = (last.speed(f"box_{name}") for name in ("x", "z", "theta"))
    return (z - 1) ** 2 + 0.1 * (x**2 + theta**2 + vx**2 + vz**2 + omega**2)


@functools.cache
def flip() -> Task:
    """Box flip (paper, section II): one finger tips a box upright and to the origin."""
    return Task(
        "flip",
        steps=599,
        cost=flip_cost,
        success=0.1,
        goal=(0.0, 0.25, 0.0),
        exact=Rule(step_size=0.1, iterations=5),
        stochastic=Rule(step_size=0.1, iterations=10, sigma=0.5),
        budget=100,
        window=((-0.5, 0.5), (0.0, 1.0)),
    )


@functools.cache
def grasp() -> Task:
    """Box grasp (paper, section II): two fingers lift a box to 1 m. Its landscape shows the symmetric setpoints."""
    return Task(
        "grasp",
        steps=499,
        cost=grasp_cost,
        success=0.2,
        goal=(0.0, 1.0, 0.0),
        exact=Rule(step_size=0.5, iterations=100),
        stochastic=Rule(step_size=0.5, iterations=1000, sigma=0.1),
        budget=1000,
        window=((-1.0, 1.0), (0.0, 2.0)),
        mirrored=True,
    )


TASKS: dict[str, Callable[[], Task]] = {"flip": flip, "grasp": grasp}
LIBRARY.update(TASKS)


def get_task(task: str | Task, knots: int | None = None) -> Task:
    """The paper's task "flip" or "grasp"; with `knots`, its setpoints change over time. A Task is returned as it is.

    Equal calls return the same task.

    Raises:
      InputError: for an unknown name, what is no task, or knots that are none or more than the time steps.
    """
    found = get_problem(task, knots)
    if not isinstance(found, Task):
        raise InputError(f"{found.name} is a problem, and none of the paper's tasks; name one of {', '.join(TASKS)}")
    return found
