"""The one road through the package: a task, a simulator and setpoints give a trajectory, or a cost to differentiate."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines import Simulator, check_names, make_simulator
from tog_mjx.engines.objective import Motion, Objective
from tog_mjx.engines.objective import objective as problem_objective
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.problems.problem import Problem
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Numbers, Scalar, Setpoints

_FARTHEST = 1e9
"""m of a setpoint: what is computed of one overflows from 1e19 m on in float32, and from 1e150 m on in float64."""


class Trajectory(NamedTuple):
    """States at `time` [T] (s): box [T, 6] (x, z, theta, vx, vz, omega) and fingers [T, F, 4] (x, z, vx, vz)."""

    time: Float[Array, " T"]
    box: Float[Array, "T 6"]
    fingers: Float[Array, "T F 4"]


@overload
def rollout(task: str | Task, u: Numbers, engine: str = "mjx", **options: str) -> Trajectory: ...
@overload
def rollout(task: Problem, u: Numbers, engine: str = "mjx", **options: Any) -> Motion: ...
def rollout(task: str | Task | Problem, u: Numbers, engine: str = "mjx", **options: Any) -> Trajectory | Motion:
    """The motion of a task under setpoints, or of a problem under its variables.

    Args:
      task: "flip", "grasp" or a Task, or a Problem, whose motion is a `tog_mjx.engines.objective.Motion`.
      u: setpoints [2F] in m, or [K * 2F] of a task with K knots; x [n] of a problem.
      engine: "mjx", "penalty" or "released"; `options` as in `objective`.

    Raises:
      InputError: for an unknown name or option, or setpoints of the wrong shape or not finite.
    """
    if isinstance(task, Problem):
        return problem_objective(task, _engine(engine, options), **options).motion(u)
    task = get_task(task)
    u = check_setpoints(task, u)
    return _compiled(trajectory, task, _engine(engine, options), options)(u)


@overload
def objective(task: str | Task, engine: str = "mjx", **options: str) -> Callable[..., Scalar]: ...
@overload
def objective(task: Problem, engine: str = "mjx", **options: Any) -> Objective: ...
def objective(task: str | Task | Problem, engine: str = "mjx", **options: Any) -> Callable[..., Scalar]:
    """A task's cost J(u), a compiled function of setpoints u [K * 2F]: to jit, vmap and differentiate in both modes.

    Args:
      task: "flip", "grasp" or a Task; or a Problem, see `tog_mjx.engines.objective.objective`.
      engine: "mjx" (option `differentiation="implicit" | "saltation" | "native"`), "penalty" (options
        `friction="mujoco" | "paper"` and `differentiation="native" | "saltation"`) or "released" (option
        `mended`, one quirk out of `tog_mjx.paper.released.MENDED`).

    Its precision is that of JAX's x64 flag at the call. Equal calls share one compiled function.

    Raises:
      InputError: for an unknown name or option; J raises it for setpoints of the wrong shape or not finite.
    """
    if isinstance(task, Problem):
        return problem_objective(task, _engine(engine, options), **options)
    task, engine = get_task(task), _engine(engine, options)
    _compiled(final_cost, task, engine, options)  # Names are checked now, not at the first call.
    return functools.partial(_cost, task, engine, options)


def _engine(name: str, options: dict[str, Any]) -> str:
    """The engine's name, also by the older word for it, which leaves the options."""
    return str(options.pop("simulator", name))


def _cost(task: Task, simulator: str, options: dict[str, str], u: Numbers) -> Scalar:
    """J(u), by names: so that an objective can be pickled."""
    return _compiled(final_cost, task, simulator, options)(check_setpoints(task, u))


def final_cost(task: Task, simulator: Simulator, u: Setpoints) -> Scalar:
    """J at the end of the horizon. `simulator` may be a traced pytree: J is differentiable in its parameters too."""

    def advance(state: Any, setpoints: Setpoints | None) -> tuple[Any, None]:
        return simulator.step(state, u if setpoints is None else setpoints), None

    state, _ = jax.lax.scan(advance, simulator.init(*task.start), interpolate(task, u), task.horizon - 1)
    return task.cost(simulator.observe(state)[0])


def trajectory(task: Task, simulator: Simulator, u: Setpoints) -> Trajectory:
    """The whole motion, the initial state first."""

    def advance(state: Any, setpoints: Setpoints | None) -> tuple[Any, Any]:
        state = simulator.step(state, u if setpoints is None else setpoints)
        return state, simulator.observe(state)

    start = simulator.init(*task.start)
    _, states = jax.lax.scan(advance, start, interpolate(task, u), task.horizon - 1)
    box, fingers = jax.tree.map(
        lambda first, rest: jnp.concatenate([first[None], rest]), simulator.observe(start), states
    )
    return Trajectory(jnp.arange(task.horizon) * task.scene.model.opt.timestep, box, fingers)


def interpolate(task: Task, u: Setpoints) -> Float[Array, "steps m"] | None:
    """The setpoints [2F] of every time step, from those of the knots; None where they are constant."""
    if task.knots == 1:
        return None
    steps = task.horizon - 1
    position = np.linspace(0, task.knots - 1, steps)
    before = np.minimum(position.astype(int), task.knots - 2)
    share = jnp.asarray((position - before)[:, None], u.dtype)
    table = jnp.reshape(u, (task.knots, -1))
    return (1 - share) * table[before] + share * table[before + 1]


def check_setpoints(task: Task, u: Numbers) -> Float[Array, " n"]:
    """u as an array of JAX's default float type.

    Raises:
      InputError: for setpoints of the wrong shape, not finite or absurdly far (of what a transformation traces that is
      not known).
    """
    size = task.initial_guess.size
    each = "x and z of each finger" + (" at each knot" if task.knots > 1 else "") + " in m"
    try:
        # Numbers stay numbers inside a transformation of something else.
        with jax.ensure_compile_time_eval():
            u = jnp.asarray(u, float)
    except (TypeError, ValueError):
        raise InputError(f"setpoints {u!r} are not numbers; give {size} of them, {each}") from None
    if u.shape != (size,):
        shape = ", ".join(map(str, u.shape))
        raise InputError(f"setpoints have shape [{shape}]; {task.name} takes [{size}], {each}")
    if not isinstance(u, jax.core.Tracer) and not (np.abs(np.asarray(u)) <= _FARTHEST).all():
        why = "not finite" if not np.isfinite(np.asarray(u)).all() else "too far away"
        raise InputError(f"setpoints {u.tolist()} are {why}; give finite numbers of m, up to {_FARTHEST:g}")
    return u


def _compiled(function: Callable, task: Task, simulator: str, options: dict[str, str]) -> Callable[[Array], Any]:
    """`function(task, simulator, u)`, compiled once for each task, simulator, set of options and default precision."""
    check_names(simulator, options)
    return _compile(function, task, simulator, tuple(sorted(options.items())), str(jnp.zeros(0).dtype))


@functools.lru_cache(maxsize=64)
def _compile(
    function: Callable, task: Task, simulator: str, options: tuple[tuple[str, str], ...], _dtype: str
) -> Callable[[Array], Any]:
    engine = make_simulator(simulator, task.scene, **dict(options))
    return jax.jit(lambda u: function(task, engine, u))
