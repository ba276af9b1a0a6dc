"""The method to take for a task through contact: autodiff's gradients, Adam, and steps that fit the budget.

What the studies found (scripts/findings): autodiff's gradient leads somewhere useful almost everywhere, and what fails
is the paper's plain step, which follows its length. A gradient through contact is 100 times steeper at a touch than on
a flat, so one step either creeps or leaves the basin. Adam divides by the recent size of each component and moves every
variable by about the same length, which is chosen so that all updates together span twice the task's window. Its memory
of sizes is 20 updates long (beta_2 = 0.95): with the usual thousand, a single touch stalls the rest of the run.

Autodiff's gradient is exact between two jumps of the motion, and not the slope of the landscape (`tog_mjx.touch`). It
is the default by its successes alone: wherever both were tried, it succeeds at least as often as the gradient with the
jumps.

Nothing here knows of a symmetry, or of the goal.
"""

from collections.abc import Callable
from numbers import Real

import jax.numpy as jnp
import optax

from tog_mjx.descent import Descent, descend
from tog_mjx.errors import InputError, require_kind
from tog_mjx.gradients import exact
from tog_mjx.rollout import objective
from tog_mjx.simulators import check_names, gradient_charge, precision
from tog_mjx.tasks import Task, get_task
from tog_mjx.types import Numbers, Scalar


def solve(
    task: str | Task,
    budget: int | float = 1000,
    simulator: str = "mjx",
    guess: Numbers | None = None,
    report: Callable[[int], None] | None = None,
    differentiation: str | None = None,
) -> Descent:
    """Descends on the task's cost; take `setpoints_best` of the record.

    Args:
      task: "flip", "grasp" or a Task, with any number of knots.
      budget: evaluations of J, of which a gradient takes `GRADIENT_CHARGE` of its simulator, or `SALTATION_CHARGE`.
      simulator: "mjx", "penalty" or "released".
      guess: initial setpoints [K * 2F] in m; the default is the task's.
      report: called now and then with the number of gradients evaluated so far.
      differentiation: which gradient to follow, an option of the simulator; None is its own, the derivative between two
        jumps of the motion. That succeeds at least as often on both tasks, with any number of knots: on the grasp with
        constant setpoints, from 3 cm off, in all runs, and "saltation", the slope with the jumps, in none, since minima
        of the landscape lie in its way which the other does not see. That is an outcome, not a reason: an error that
        helps here may hurt elsewhere. On the flip "saltation" often ends lower, and with 4 knots or more both grasp.
        Where both can be afforded, try both, and keep the record of lower cost.

    Raises:
      InputError: for an unknown name or differentiation, a budget below one gradient, or a guess of the wrong shape or
        not finite.
    """
    task = get_task(task)
    options = {"differentiation": differentiation} if differentiation else {}
    check_names(simulator, options)
    charge = gradient_charge(simulator, differentiation)
    require_kind("budget", budget, Real, "give a number of evaluations of J")
    if not charge <= budget < float("inf"):
        raise InputError(f"budget is {budget}: one gradient of {simulator} takes {charge} evaluations; give more")
    gradients = int(budget / charge)
    with precision(simulator):
        return descend(
            exact(objective(task, simulator, **options)),
            task.initial_guess if guess is None else guess,
            rule=update_rule(step_size(task, gradients)),
            iterations=gradients - 1,
            report=report,
        )


def step_size(task: Task, updates: int) -> float:
    """Metres a variable moves in one of so many updates: all together span twice the longer side of the window."""
    return 2 * max(high - low for low, high in task.window) / updates


def update_rule(step: Scalar | float) -> optax.GradientTransformation:
    """Adam with a memory of about 20 updates."""
    return optax.adam(jnp.asarray(step), b1=0.9, b2=0.95)
