"""What the friction law means for the optimum: descend under each law, and judge the answers under all."""

import jax
import numpy as np

from tog_mjx.engines import PenaltySimulator
from tog_mjx.engines.objective import objective
from tog_mjx.gradients import exact
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import descend

LAWS = PenaltySimulator.OPTIONS["friction"]


def optimum(task: Task, law: str) -> tuple[np.ndarray, list[float]]:
    """The best setpoints [n] of exact descent on the penalty simulator with this friction law and Table I's settings.

    And their costs J: on the penalty simulator under each of `LAWS`, then on MJX. In float64.
    """
    with jax.enable_x64():
        descent = descend(
            exact(objective(task, "penalty", friction=law)),
            task.initial_guess,
            step_size=task.exact.step_size,
            iterations=task.exact.iterations,
            key=jax.random.key(0),
            tolerance=0.0,
        )
        best = descent.best
        judges = [*(objective(task, "penalty", friction=other) for other in LAWS), objective(task, "mjx")]
        return best, [float(judge(best)) for judge in judges]
