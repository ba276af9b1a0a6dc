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

import contextlib
from collections.abc import Callable
from numbers import Real
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from tog_mjx.engines import Objective, choose_engine, gradient_charge, objective, precision
from tog_mjx.engines.simulator import AUTO
from tog_mjx.gradients import common_starts, exact
from tog_mjx.gradients.reversible import unless_refused
from tog_mjx.problems.library import get_problem
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.running import user_code
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.older_names import older_keywords
from tog_mjx.running.pytrees import variables
from tog_mjx.running.types import AnyArray, Scalar
from tog_mjx.solving.descent import Descent, descend
from tog_mjx.solving.held_out import SHARE, judge

CHARGE = 4.0
"""Evaluations of J that a gradient of any function counts as: what those of the simulators take."""


@older_keywords(task="problem", simulator="engine")
def solve(
    problem: str | Problem | Callable[[Any], Scalar],
    guess: Any = None,
    *,
    budget: int | float = 1000,
    reach: int | float | None = None,
    engine: str | None = None,
    differentiation: str | None = None,
    report: Callable[[int], None] | None = None,
) -> Descent:
    """Descends on a function J, or on a problem's cost; take `best` of the record.

    Of a problem with `Starts` each update draws others, so a recorded cost is that of its draw. What is best is judged
    on held-out starts: `SHARE` of the budget simulates eleven iterates on those, see `Descent.held_out`. The rule is
    then `rule_of_many`.

    Args:
      problem: a JAX function J of a vector or a pytree, whose value is a number, a Problem, or the name of one, "flip"
        or "grasp". It runs in the precision of JAX's x64 flag, but for flip and grasp, which run in float64.
      guess: where to begin, a vector [n] or any pytree of arrays; in the record, setpoints and gradients are then such
        pytrees, each leaf with an axis of iterates before its own. Of a problem, its x [n]; the default is its own.
      budget: evaluations of J, of which a gradient takes `CHARGE`; of a problem, for each start, `GRADIENT_CHARGE` of
        its engine, or `SALTATION_CHARGE`; of "auto" those of MJX, whichever is chosen.
      reach: how far the answer may lie from the guess, in the units of the variables: all updates together can move
        each of them by twice as much, and where starts are drawn by as much. None: as far as a variable is from zero,
        and at least 1; of a problem, its `reach`.
      engine: of a problem: "mjx" (if None), "mujoco", "penalty" or "released", or "auto", see `tog.objective`.
      differentiation: of a problem: which gradient to follow, an option of the simulator; None is its own, the
        derivative between two jumps of the motion. That succeeds at least as often on flip and grasp, with any number
        of knots: on the grasp with constant setpoints, from 3 cm off, in all runs, and "saltation", the slope with the
        jumps, in none, since minima of the landscape lie in its way which the other does not see. That is an outcome,
        not a reason: an error that helps here may hurt elsewhere. On the flip "saltation" often ends lower, and with 4
        knots or more both grasp. Where both can be afforded, try both, and keep the record of lower cost.
      report: called now and then with the number of gradients evaluated so far.

    Raises:
      InputError: for an unknown name or differentiation, a budget below one gradient, a guess of the wrong shape or
        not finite, or a function that fails, or returns no number, or cannot be differentiated.

    Units: those of J and of its variables.
    Gradient: none of a descent, whose record is NumPy's; the one that it follows is that of `tog.objective`, or of J.
    Source: Adam: Kingma and Ba, ICLR 2015; its settings: own, `scripts/findings`.
    """
    require_kind("budget", budget, Real, "give a number of evaluations of J")
    if reach is not None:
        require_kind("reach", reach, Real, "give a number, in the units of the variables")
        if not 0 < reach < float("inf"):
            raise InputError(f"reach is {reach}: give a positive number, in the units of the variables")
    if callable(problem):
        if engine or differentiation:
            raise InputError("engine and differentiation are a problem's; a function of your own has its own")
        return _descend(_function(problem, guess), budget, reach, report)
    problem = get_problem(problem)
    engine = engine or "mjx"
    charge = gradient_charge(engine, differentiation)
    if engine == AUTO:
        options = {"differentiation": differentiation} if differentiation else {}
        engine = choose_engine(problem, max(1, int(budget / charge)), **options).engine
    with precision(engine) if problem.in_float64 else contextlib.nullcontext():
        return _descend(_scene(problem, guess, engine, differentiation, charge), budget, reach, report)


class _Given(NamedTuple):
    """What to descend on: J, a guess [n], how far it may go, and the evaluations that a gradient takes; J once more
    if it `draws` starts."""

    name: str
    J: Callable[..., Scalar]
    guess: Any
    far: float | Float[np.ndarray, " n"]
    charge: float
    draws: Objective | None = None
    limits: tuple[AnyArray, AnyArray] = (np.array(-np.inf), np.array(np.inf))
    restore: Callable[[AnyArray], Any] = lambda rows: rows


def _function(function: Callable[[Any], Scalar], guess: Any) -> _Given:
    if guess is None:
        raise InputError("a function has no guess of its own; give one, a vector or a pytree")
    name, given = getattr(function, "__name__", "the objective"), variables(guess, "the guess")

    def number(u: Float[Array, " n"]) -> Float[Array, ""]:
        return user_code.number(name, function, given.restore(u))

    return _Given(name, number, given.point, np.maximum(np.abs(given.point), 1.0), CHARGE, restore=given.restore)


def _scene(problem: Problem, guess: Any, engine: str, differentiation: str | None, charge: float) -> _Given:
    if isinstance(guess, Real):
        raise InputError(f"the guess is {guess}: give a vector; a budget is given by its name, budget={guess}")
    J = objective(problem, engine, **({"differentiation": differentiation} if differentiation else {}))
    x = jnp.clip(problem.check(problem.x0 if guess is None else guess), *problem.limits)
    given = _Given(f"{problem.name} on {engine}", J, x, problem.reach, charge, limits=problem.limits)
    if isinstance(problem.start, Starts):
        return given._replace(draws=J, charge=charge * problem.start.count)
    return given


def _descend(given: _Given, budget: int | float, reach: int | float | None, report: Callable | None) -> Descent:
    judging = SHARE * budget if given.draws else 0.0
    if not given.charge <= budget - judging < float("inf"):
        rest = f", beside the {SHARE:.0%} of it that judge" if given.draws else ""
        raise InputError(
            f"budget is {budget}: one gradient of {given.name} takes {given.charge} evaluations{rest}; give more"
        )
    gradients = int((budget - judging) / given.charge)
    step = 2 * (given.far if reach is None else reach) / gradients
    rule = rule_of_many(step, gradients) if given.draws else update_rule(step)
    if np.isfinite(given.limits).any():
        rule = optax.chain(rule, _within(*given.limits))
    estimate = common_starts(exact, given.J) if given.draws else exact(given.J)
    found = unless_refused(lambda: descend(estimate, given.guess, rule=rule, iterations=gradients - 1, report=report))
    if found is None:
        told = f"{given.name} cannot be differentiated in reverse mode: there is a loop of unknown length in it"
        raise InputError(f"{told}; use jax.lax.scan, and tog.step in place of mjx.step")
    if given.draws:
        found = judge(found, given.draws, judging)
    return found._replace(setpoints=given.restore(found.setpoints), gradients=given.restore(found.gradients))


def _within(low: Float[AnyArray, " n"], high: Float[AnyArray, " n"]) -> optax.GradientTransformation:
    """Cuts an update where it would leave the bounds."""

    def stay(updates: Any, state: Any, x: Any = None) -> tuple[Any, Any]:
        return jnp.clip(x + updates, low, high) - x, state

    return optax.GradientTransformation(lambda _: optax.EmptyState(), stay)


def step_size(problem: Problem, updates: int) -> Any:
    """How far a variable moves in one of so many updates: all together span twice the problem's reach."""
    return 2 * problem.reach / updates


def update_rule(step: Float[AnyArray, "..."] | float) -> optax.GradientTransformation:
    """Adam with a memory of about 20 updates; `step` is one number, or one for each variable."""
    return optax.adam(jnp.asarray(step), b1=0.9, b2=0.95)


def rule_of_many(step: Float[AnyArray, "..."] | float, updates: int) -> optax.GradientTransformation:
    """For costs whose starts differ from update to update: as `update_rule`, with gradients whose norm is cut at 1, for
    one start may touch where others do not, and a step that falls to nothing as a cosine does.

    Measured on the closed loops of scripts/findings (`penalty`, 32,000 evaluations, eight policies each, success on 256
    new starts, by which it was also chosen). The last policy grasps in 74 % (mean over policies), with `update_rule` in
    62 %; the best one on held-out starts in 99 % with both, at a J of at most 0.06 for 0.14: it is the judge who gains
    most. Both flip in 98 %. Half the step, and a quarter of it, grasp in 96 and 94 %.
    """
    fall = optax.cosine_decay_schedule(1.0, updates)
    return optax.chain(optax.clip_by_global_norm(1.0), update_rule(step), optax.scale_by_schedule(fall))
