"""The method to take for a problem through contact: autodiff's gradients, Adam, and steps that fit the budget.

What the studies found (scripts/findings): autodiff's gradient leads somewhere useful almost everywhere, and what fails
is the paper's plain step, which follows its length. A gradient through contact is 100 times steeper at a touch than on
a flat, so one step either creeps or leaves the basin. Adam divides by the recent size of each component and moves every
variable by about the same length, which is chosen so that all updates together span twice the window. Its memory
of sizes is 20 updates long (beta_2 = 0.95): with the usual thousand, a single touch stalls the rest of the run.

Autodiff's gradient is exact between two jumps of the motion, and not the slope of the landscape
(`tog_mjx.stepping.touch`). It
is the default by its successes alone: wherever both were tried, it succeeds at least as often as the gradient with the
jumps.

Nothing here knows of a symmetry, or of the goal.
"""

import functools
from collections.abc import Callable
from numbers import Real
from typing import Any

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from tog_mjx.checks.measured.modes import REFUSED
from tog_mjx.engines import check_names, gradient_charge, precision
from tog_mjx.engines.objective import objective
from tog_mjx.gradients import exact
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.pytrees import variables
from tog_mjx.running.types import AnyArray, Scalar
from tog_mjx.running.user_code import call, real
from tog_mjx.solving.descent import Descent, descend

CHARGE = 4.0
"""Evaluations of J that a gradient of any function counts as: what those of the simulators take."""


def solve(
    problem: str | Task | Problem | Callable[[Any], Scalar],
    guess: Any = None,
    *,
    budget: int | float = 1000,
    reach: int | float | None = None,
    engine: str | None = None,
    simulator: str | None = None,
    differentiation: str | None = None,
    report: Callable[[int], None] | None = None,
) -> Descent:
    """Descends on a function J, or on a task's cost; take `setpoints_best` of the record.

    Args:
      problem: a JAX function J of a vector or a pytree, whose value is a number; it runs in the precision of JAX's x64
        flag as it stands. Or "flip", "grasp" or a Task, with any number of knots. Or a Problem: of one with `Starts`
        each update draws others, and the recorded costs are theirs.
      guess: where to begin, a vector [n] or any pytree of arrays; in the record, setpoints and gradients are then such
        pytrees, each leaf with an axis of iterates before its own. Of a task, initial setpoints [K * 2F] in m; the
        default is the task's.
      budget: evaluations of J, of which a gradient takes `CHARGE`; of a task `GRADIENT_CHARGE` of its simulator, or
        `SALTATION_CHARGE`.
      reach: how far the answer may lie from the guess, in the units of the variables: all updates together can move
        each of them by twice as much. None: as far as a variable is from zero, and at least 1; of a task, the
        longer side of its window.
      engine: of a task or a problem: "mjx" (if None), "penalty" or "released". `simulator` is its older name.
      differentiation: of a task or a problem: which gradient to follow, an option of the simulator; None is its own,
        the derivative between two jumps of the motion. That succeeds at least as often on both tasks, with any number
        of knots: on the grasp with constant setpoints, from 3 cm off, in all runs, and "saltation", the slope with the
        jumps, in none, since minima of the landscape lie in its way which the other does not see. That is an outcome,
        not a reason: an error that helps here may hurt elsewhere. On the flip "saltation" often ends lower, and with 4
        knots or more both grasp. Where both can be afforded, try both, and keep the record of lower cost.
      report: called now and then with the number of gradients evaluated so far.

    Raises:
      InputError: for an unknown name or differentiation, a budget below one gradient, a guess of the wrong shape or
        not finite, or a function that fails, or returns no number, or cannot be differentiated.
    """
    require_kind("budget", budget, Real, "give a number of evaluations of J")
    if reach is not None:
        require_kind("reach", reach, Real, "give a number, in the units of the variables")
        if not 0 < reach < float("inf"):
            raise InputError(f"reach is {reach}: give a positive number, in the units of the variables")
    engine = engine or simulator
    if isinstance(problem, Problem):
        return _solve_problem(problem, guess, budget, reach, engine or "mjx", differentiation, report)
    if callable(problem):
        if engine or differentiation:
            raise InputError("engine and differentiation are a task's; a function of your own has its own")
        return _solve_function(problem, guess, budget, reach, report)
    task = get_task(problem)
    if isinstance(guess, Real):
        raise InputError(f"the guess is {guess}: give setpoints; a budget is given by its name, budget={guess}")
    engine = engine or "mjx"
    options: dict[str, Any] = {"differentiation": differentiation} if differentiation else {}
    check_names(engine, options)
    gradients = _gradients(budget, gradient_charge(engine, differentiation), engine)
    with precision(engine):
        return descend(
            exact(objective(task, engine, **options)),
            task.initial_guess if guess is None else guess,
            rule=update_rule(step_size(task, gradients) if reach is None else 2 * reach / gradients),
            iterations=gradients - 1,
            report=report,
        )


def _solve_function(
    function: Callable[[Any], Scalar],
    guess: Any,
    budget: int | float,
    reach: int | float | None,
    report: Callable | None,
) -> Descent:
    if guess is None:
        raise InputError("a function has no guess of its own; give one, a vector or a pytree")
    name, given = getattr(function, "__name__", "the objective"), variables(guess, "the guess")
    gradients = _gradients(budget, CHARGE, name)
    far = np.maximum(np.abs(given.point), 1.0) if reach is None else reach

    def number(u: Float[Array, " n"]) -> Float[Array, ""]:
        found = real(name, call(f"{name} fails", function, given.restore(u)), "one number")
        if found.size != 1:
            raise InputError(f"{name} returns an array of shape {list(found.shape)}; give one number")
        return found.reshape(())

    try:
        rule = update_rule(2 * far / gradients)
        found = descend(exact(number), given.point, rule=rule, iterations=gradients - 1, report=report)
    except ValueError as error:
        if REFUSED not in str(error):
            raise
        told = f"{name} cannot be differentiated in reverse mode: there is a loop of unknown length in it"
        raise InputError(f"{told}; use jax.lax.scan, and tog.step in place of mjx.step") from error
    setpoints, slopes = given.restore(found.setpoints), given.restore(found.gradients)
    return found._replace(setpoints=setpoints, gradients=slopes)


def _solve_problem(
    problem: Problem,
    guess: Any,
    budget: int | float,
    reach: int | float | None,
    engine: str,
    differentiation: str | None,
    report: Callable | None,
) -> Descent:
    """In the precision of JAX's x64 flag; x stays within its bounds."""
    options: dict[str, Any] = {"differentiation": differentiation} if differentiation else {}
    J = objective(problem, engine, **options)
    starts = problem.start if isinstance(problem.start, Starts) else None
    charge = gradient_charge(engine, differentiation) * (starts.count if starts else 1)
    gradients = _gradients(budget, charge, f"{problem.scene.name} on {engine}")
    low, high = problem.limits

    def estimate(key: Array, x: Float[Array, " n"]) -> tuple[Array, Array]:
        return exact(functools.partial(J, key=key) if starts else J)(key, x)

    def stay(updates: Any, state: Any, x: Any = None) -> tuple[Any, Any]:
        return jnp.clip(x + updates, low, high) - x, state

    rule = update_rule(2 * (problem.bound.scale if reach is None else reach) / gradients)
    within = optax.GradientTransformation(lambda _: optax.EmptyState(), stay)
    return descend(
        estimate,
        jnp.clip(problem.check(problem.x0 if guess is None else guess), low, high),
        rule=optax.chain(rule, within),
        iterations=gradients - 1,
        report=report,
    )


def _gradients(budget: int | float, charge: float, whose: str) -> int:
    """How many the budget pays for."""
    if not charge <= budget < float("inf"):
        raise InputError(f"budget is {budget}: one gradient of {whose} takes {charge} evaluations; give more")
    return int(budget / charge)


def step_size(task: Task, updates: int) -> float:
    """Metres a variable moves in one of so many updates: all together span twice the longer side of the window."""
    return 2 * max(high - low for low, high in task.window) / updates


def update_rule(step: Float[AnyArray, "..."] | float) -> optax.GradientTransformation:
    """Adam with a memory of about 20 updates; `step` is one number, or one for each variable."""
    return optax.adam(jnp.asarray(step), b1=0.9, b2=0.95)
