"""The cheaper of the two engines that move any scene, where both give the same motion: a short trial says.

C MuJoCo begins at once, and its time for a gradient is measured. MJX would have to compile one, for half a minute; only
one step of it is compiled, which tells whether both simulate the same and what a gradient would cost.
"""

import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tog_mjx.engines.engine import check_engine, make_engine
from tog_mjx.engines.program import program
from tog_mjx.engines.simulator import AUTO, gradient_charge
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Scalar
from tog_mjx.stepping.mjx_state import MOVING

GRADIENTS = 250
"""What the trial weighs up, unless told otherwise: those of a descent with the default budget."""
SAMPLES, CLOSE = 8, 1e-4
"""Steps of a motion that are compared, and their largest relative difference: solvers leave 1e-8 or less."""


class Choice(NamedTuple):
    """ "mjx" or "mujoco", and why, in a clause."""

    engine: str
    reason: str


def resolved(problem: Problem, engine: str, options: Mapping[str, Any]) -> str:
    """The engine's name, where it is "auto" that of the one chosen."""
    return choose_engine(problem, **options).engine if engine == AUTO else engine


def choose_engine(problem: Problem, gradients: int = GRADIENTS, **options: Any) -> Choice:
    """The engine for so many gradients of a problem at its guess. Equal calls share one trial.

    It is "mjx" on a GPU or a TPU, where C MuJoCo cannot move the problem, and where a step of the two differs; "mujoco"
    where MJX refuses the scene; else the one that is done sooner. `options` are as in `tog.objective`.

    Raises:
      InputError: where neither can move it.
    """
    with jax.enable_x64():  # Told apart by their last digits.
        return _chosen(problem, gradients, tuple(sorted(options.items())))


@functools.lru_cache(maxsize=64)
def _chosen(problem: Problem, gradients: int, options: tuple[tuple[str, Any], ...]) -> Choice:
    if jax.default_backend() != "cpu":
        return Choice("mjx", f"JAX runs on {jax.default_backend()}, where MJX moves many at a time")
    if refusal := _refusal(problem, "mujoco", dict(options)):
        check_engine(problem, "mjx", dict(options))
        return Choice("mjx", refusal)
    if refusal := _refusal(problem, "mjx", dict(options)):
        return Choice("mujoco", refusal)
    ours, mjx = _seconds_of_c(problem, options), _one_step(problem)
    if mjx.apart > CLOSE:
        return Choice("mjx", f"a step of C MuJoCo differs by {mjx.apart:.0e}: tog check says in what")
    theirs = problem.steps * mjx.seconds * gradient_charge("mjx", dict(options).get("differentiation"))
    sooner = "mujoco" if gradients * ours <= mjx.seconds_compile + gradients * theirs else "mjx"
    told = f"a gradient takes {1e3 * ours:.3g} ms on C MuJoCo, on MJX about {1e3 * theirs:.3g} ms once it is compiled"
    return Choice(sooner, f"{told}; a step of both is the same to {mjx.apart:.0e}")


def _refusal(problem: Problem, engine: str, options: dict[str, Any]) -> str:
    """Why an engine cannot move a problem, or nothing."""
    try:
        check_engine(problem, engine, options)
        if engine == "mujoco":  # Costs may ask for what it does not have.
            jax.eval_shape(jax.grad(_cost(problem, tuple(options.items()))), problem.check(problem.x0))
    except InputError as error:
        return str(error)
    return ""


def _cost(problem: Problem, options: tuple) -> Callable[[Array], Scalar]:
    return lambda x: program(problem, "mujoco", options).mean(x, None)


def _seconds_of_c(problem: Problem, options: tuple) -> float:
    """Of a gradient, the shorter one of two runs, when it is compiled."""
    gradient, runs = jax.jit(jax.grad(_cost(problem, options))), []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(gradient(problem.check(problem.x0)))
        runs.append(time.perf_counter() - began)
    return min(runs[1:])


class _Step(NamedTuple):
    """How far steps of MJX are from those of a motion of C MuJoCo, at most, relative to what moves in the step; what
    one step takes, from one start or from all that a problem has, and what it took to compile."""

    apart: float
    seconds: float
    seconds_compile: float


def _one_step(problem: Problem) -> _Step:
    motion = program(problem, "mujoco").motion(problem.check(problem.x0), None)
    engine, start = make_engine(problem, "mjx"), program(problem, "mjx").origin
    many = problem.start.count if isinstance(problem.start, Starts) else 1
    chosen = np.resize(np.linspace(0, problem.steps - 1, SAMPLES).astype(int), max(SAMPLES, many))
    before, expected = (
        {name: jnp.asarray(getattr(motion, name)[chosen + later]) for name in MOVING} for later in (0, 1)
    )

    def after(given: tuple[dict[str, Array], Array]) -> dict[str, Array]:
        state, ctrl = given
        carry, _ = engine.step(engine.model, engine.begin(engine.model, {**start, **state}), ctrl)
        return {name: carry[name] for name in MOVING}

    in_turns = jax.vmap(after) if many > 1 else functools.partial(jax.lax.map, after)
    given = before, jnp.asarray(motion.ctrl[chosen])
    began = time.perf_counter()
    run = jax.jit(in_turns).lower(given).compile()
    compiled = time.perf_counter()
    jax.block_until_ready(run(given))  # To warm up.
    warm = time.perf_counter()
    found = jax.block_until_ready(run(given))
    seconds = (time.perf_counter() - warm) / (1 if many > 1 else SAMPLES)
    ours, theirs = (np.concatenate([end[name] - before[name] for name in MOVING], 1) for end in (found, expected))
    sizes = np.maximum(np.linalg.norm(theirs, axis=1), np.finfo(float).eps ** 0.5)
    return _Step(float((np.linalg.norm(ours - theirs, axis=1) / sizes).max()), seconds, compiled - began)
