"""The checks of any JAX function."""

import contextlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.agreement import OF_A_FUNCTION, OF_C_MUJOCO, agreement, sweep
from tog_mjx.checks.measured.estimators import which_to_follow
from tog_mjx.checks.measured.jumps import find_jumps, judge_jumps
from tog_mjx.checks.measured.modes import reverse
from tog_mjx.checks.measured.second_order import second_order as check_second_order
from tog_mjx.checks.measured.single import judge_single
from tog_mjx.checks.measured.zeros import zeros
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict, reported
from tog_mjx.engines.objective import Objective
from tog_mjx.engines.objective import objective as problem_objective
from tog_mjx.problems.problem import Problem
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.pytrees import variables
from tog_mjx.running.user_code import call, real

DIRECTIONS = 6
"""Derivatives are taken in all variables up to so many, else along so many random directions."""

Function = Callable[[Float[Array, " n"]], Array]


def check(
    objective: Callable[..., Array] | Problem,
    x: Any = None,
    *,
    estimators: bool = False,
    second_order: bool = False,
    report: Report | None = None,
    engine: str = "mjx",
) -> Verdict:
    """Can the gradient of `objective` at x be trusted?

    It is run in the precision of JAX's x64 flag as it stands; float64 tells more.

    Args:
      objective: a JAX function of an array [n], or of a pytree; its value is a number or an array [m]. Or a Problem:
        its variables have names and sizes of their own, and its guess stands for an x that is None.
      x: the point, a vector [n], or any pytree of arrays: all of them as floats. Of more numbers than DIRECTIONS the
        verdict names the leaves, where there are no more than so many.
      estimators: ask too whether to follow this gradient or a stochastic one, see `checks.measured.estimators`;
        of several values, to lower the one whose derivative is largest.
      second_order: check second derivatives too, of a fixed random sum of several values: what Newton's method uses.
      report: called with a check's name before it runs, and again with its finding.
      engine: what moves a Problem, see `tog.objective`; C MuJoCo where that is MJX and it cannot.

    Raises:
      InputError: for an x that holds what are no finite real numbers, and a function that fails or returns none.

    Units: of the function's own; its gradient per unit of each variable.
    Gradient: none of the verdict. It is about those of `objective`: that it is the slope over short steps and over wide
      ones, across the jumps of touch-downs; at a kink it says what each side has.
    Source: own, `scripts/findings`; which gradient to follow: Suh et al., ICML 2022.
    """
    function: Callable[..., Any]
    bound, refused = None, list[Finding]()
    if isinstance(objective, Problem):
        function, refused = _moved(objective, engine)
        engine, bound, x = function.engine, objective.bound, objective.x0 if x is None else x
    else:
        function = objective
        if engine != "mjx":
            raise InputError(f"engine={engine!r} is for a Problem; a function has chosen its own")
    require_kind("the objective", function, Callable, "give a function of an array or a pytree, or a Problem")
    given = variables(x)
    point = given.point
    say: Report = report or (lambda *_: None)
    name = getattr(function, "__name__", "the objective")
    scale = bound.scale if bound else np.maximum(np.abs(point), 1.0)
    all_names = bound.names if bound else given.names
    directions, names = directions_at(scale, all_names if point.size <= DIRECTIONS else (), given.parts)

    def flat(x: Array) -> Array:
        found = real(name, call(f"{name} fails", function, given.restore(x)), "one number, or an array of them")
        if not found.size:
            raise InputError(f"{name} returns nothing: an array of shape {list(found.shape)}; give a number or more")
        return jnp.ravel(found)

    say("forward mode", None)
    value, slopes = forward(flat, point, directions)
    outputs = tuple(f"y[{i}]" for i in range(value.size))
    batch = jax.jit(jax.vmap(flat))
    values = lambda points: np.asarray(batch(points))  # noqa: E731
    differences = sweep(values, point, directions)

    lengths, remedy = np.linalg.norm(directions, axis=0), OF_C_MUJOCO if engine == "mujoco" else OF_A_FUNCTION
    jumps = find_jumps(values, point, directions, differences)
    checks: dict[str, Callable[[], Finding]] = {
        "finite": lambda: _finite(value, slopes),
        "zeros": lambda: zeros(slopes, differences, names, outputs),
        "agreement": lambda: judge_jumps(
            agreement(slopes, differences, remedy), slopes, jumps, names, outputs, scale=lengths
        ),
        "reverse mode": lambda: reverse(flat, point, directions, slopes),
        "precision": lambda: _precision(flat, point, directions, slopes),
    }
    if engine == "mujoco":
        del checks["precision"]  # It computes in float64, whatever the flag.
    if second_order:
        checks["second order"] = lambda: check_second_order(flat, point, directions)
    if estimators:
        lowered = outputs if value.size > 1 else ("it",)
        checks["estimators"] = lambda: which_to_follow(values, flat, point, scale, slopes, jumps, lowered)
    for finding in refused:
        say(finding.check, finding)
    findings = (*refused, *(reported(some, run, say) for some, run in checks.items()))
    subject = f"{name} in {point.size} variables" + ", through C MuJoCo" * (engine == "mujoco")
    told = findings, names, outputs, value.tolist(), (slopes / lengths).tolist(), lengths.tolist()
    return Verdict(subject, *told, engine=engine if bound else "")


def _moved(problem: Problem, engine: str) -> tuple[Objective, list[Finding]]:
    """J on the engine; where MJX cannot move the scene, which weighs nothing then, on C MuJoCo if that can."""
    try:
        return problem_objective(problem, engine), []
    except InputError as error:
        if engine != "mjx":
            raise
        with contextlib.suppress(InputError):
            return problem_objective(problem, "mujoco"), [Finding("preflight", Level.FINE, str(error))]
        raise


def directions_at(
    scale: Float[np.ndarray, " n"], names: Sequence[str], parts: Mapping[str, slice] | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Directions [n, k], each as long as a large displacement, and their names.

    Of many variables they are random; where those have `parts`, few enough, the first directions are within one each.
    """
    n = len(scale)
    if n <= DIRECTIONS:
        return np.diag(scale), tuple(names)
    random = np.random.default_rng(0).normal(size=(n, DIRECTIONS))
    told = [f"random direction {i}" for i in range(DIRECTIONS)]
    if parts and 1 < len(parts) <= DIRECTIONS:
        for i, (part, inside) in enumerate(parts.items()):
            random[: inside.start, i] = random[inside.stop :, i] = 0
            told[i] = f"{part} along a random direction"
    units = random / np.linalg.norm(random, axis=0)
    return scale[:, None] * units, tuple(told)


def forward(
    function: Function, x: Float[np.ndarray, " n"], directions: Float[np.ndarray, "n k"]
) -> tuple[np.ndarray, np.ndarray]:
    """Value [m] and derivative [m, k] along the directions."""

    @jax.jit
    def run(x: Array, directions: Array) -> tuple[Array, Array]:
        along = jax.vmap(lambda v: jax.jvp(function, (x,), (v,)), in_axes=1, out_axes=(None, 1))
        return along(directions)

    value, slopes = run(jnp.asarray(x), jnp.asarray(directions))
    return np.asarray(value, float), np.asarray(slopes, float)


def _finite(value: Float[np.ndarray, " m"], slopes: Float[np.ndarray, "m k"]) -> Finding:
    for what, numbers in (("value", value), ("gradient", slopes)):
        if bad := int((~np.isfinite(numbers)).sum()):
            sentence = f"the {what} is NaN or infinite in {bad} of {numbers.size} entries"
            remedy = "look for a root, a norm, a power or a quotient at zero: select before you divide"
            return Finding("finite", Level.FAULT, sentence, float(bad), remedy)
    return Finding("finite", Level.FINE, "value and gradient are finite")


def _precision(
    function: Function, x: Float[np.ndarray, " n"], directions: Float[np.ndarray, "n k"], slopes: np.ndarray
) -> Finding:
    if not jax.config.values["jax_enable_x64"]:
        return Finding("precision", Level.FINE, "JAX runs in float32 here, and there is no float64 to compare with")
    single, point = None, x.astype(np.float32)
    with jax.enable_x64(False), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX has one for each array of float64 that meets others.
        with contextlib.suppress(TypeError, ValueError):  # Or fails where they meet.
            if "f64[" not in str(jax.make_jaxpr(function)(point)):
                single = forward(function, point, directions.astype(np.float32))[1]
    if single is None:
        return Finding("precision", Level.FINE, "not compared: the function holds arrays of float64")
    return judge_single(slopes, single)
