"""The one road through the package: a problem, an engine and variables give a cost to differentiate, or a motion."""

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.engines.engine import Engine, check_engine, make_engine, on_plane
from tog_mjx.engines.simulator import Simulator
from tog_mjx.problems.library import get_problem
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.problems.state import State
from tog_mjx.running.errors import InputError, require_whole
from tog_mjx.running.types import Numbers, Scalar
from tog_mjx.running.user_code import number
from tog_mjx.stepping.mjx_state import START


class Motion(NamedTuple):
    """States at `time` [T] (s), T = steps + 1: qpos [T, nq], qvel [T, nv], and the controls in force, ctrl [T, nu].

    Of a scene of one box and its fingers also box [T, 6] (x, z, theta, vx, vz, omega) and fingers [T, F, 4] (x, z, vx,
    vz), else None.
    """

    time: Float[Array, " T"]
    qpos: Float[Array, "T nq"]
    qvel: Float[Array, "T nv"]
    ctrl: Float[Array, "T nu"]
    box: Any = None
    fingers: Any = None


@dataclass(frozen=True)
class Objective:
    """J(x) of a problem on an engine: a JAX function, to jit, vmap and differentiate in both modes; see `objective`.

    Of a problem with `Starts` J is the mean over starts, drawn by `key`; without one always the same.
    """

    problem: Problem
    engine: str
    options: tuple[tuple[str, str], ...] = ()
    checkpoint: int | None = None

    @property
    def __name__(self) -> str:
        return f"J of {self.problem.scene.name}"

    def __call__(self, x: Numbers, key: Key[Array, ""] | None = None) -> Scalar:
        """J at x [n]; raises InputError for an x of another shape or not finite, and a cost that fails."""
        return self.each(x, jax.random.key(0) if key is None else key).mean()

    def each(self, x: Numbers, key: Key[Array, ""], count: int | None = None) -> Float[Array, " count"]:
        """The cost of each start that the key draws, so many of them or the problem's own number; of a problem with one
        start that one [1]."""
        return self._program.costs(self.problem.check(x), key, count)

    def with_motion(self, x: Numbers) -> tuple[Motion, Scalar]:
        """The motion under x from the problem's own start, and its cost."""
        program = self._program
        return program.whole(self.problem.check(x), program.engine.model, program.origin)

    def motion(self, x: Numbers, key: Key[Array, ""] | None = None) -> Motion:
        """The motion under x; with a key those of the starts that it draws, with a leading axis."""
        return self._program.motion(self.problem.check(x), key)

    @property
    def _program(self) -> "_Program":
        return _program(self.problem, self.engine, self.options, self.checkpoint, str(jnp.zeros(0).dtype))


class _Program:
    """The functions of x behind an objective, compiled once."""

    def __init__(self, problem: Problem, engine: Engine, checkpoint: int | None = None):
        self.problem, self.engine, self._checkpoint = problem, engine, checkpoint
        self.origin = {name: getattr(engine.origin, name) for name in START}
        self.costs = jax.jit(self._costs, static_argnums=2)
        self.motion = jax.jit(self._motions)

    def cost(self, x: Array, model: Any, start: dict[str, Array]) -> Scalar:
        return self._total(*self._roll(x, model, start, self._running))

    def whole(self, x: Array, model: Any, start: dict[str, Array]) -> tuple[Motion, Scalar]:
        """The motion, and its cost."""

        def now(state: State) -> Motion:
            return Motion(state.time, state.qpos, state.qvel, state.ctrl)

        last, (seen, running) = self._roll(x, model, start, lambda state: (now(state), self._running(state)))
        motion = jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), seen, now(last))
        if self.problem.scene.is_planar:
            box, fingers = self.problem.scene.planar(motion.qpos, motion.qvel)
            motion = motion._replace(box=box, fingers=fingers)
        return motion, self._total(last, running)

    def _running(self, state: State) -> Scalar | None:
        cost = self.problem.running_cost
        return number("running_cost", cost, state) if cost else None

    def _total(self, last: State, running: Float[Array, " steps"] | None) -> Scalar:
        total = jnp.zeros(()) if running is None else running.mean()
        return total + number("cost", self.problem.cost, last) if self.problem.cost else total

    def _costs(self, x: Array, key: Key[Array, ""], count: int | None) -> Float[Array, " count"]:
        return self._from_starts(functools.partial(self.cost, x), key, count)

    def _motions(self, x: Array, key: Key[Array, ""] | None) -> Motion:
        def move(model: Any, start: dict[str, Array]) -> Motion:
            return self.whole(x, model, start)[0]

        return move(self.engine.model, self.origin) if key is None else self._from_starts(move, key)

    def _from_starts(self, function: Callable[..., Any], key: Key[Array, ""], count: int | None = None) -> Any:
        starts, model = self.problem.start, self.engine.model
        if not isinstance(starts, Starts):
            return jax.tree.map(lambda leaf: leaf[None], function(model, self.origin))
        placed, fields = starts.draw(key, starts.count if count is None else count, model, self.origin)

        def one(placed: dict[str, Array], fields: dict[str, Array]) -> Any:
            return function(model.tree_replace(fields) if fields else model, {**self.origin, **placed})

        return jax.vmap(one)(placed, fields)

    def _roll(self, x: Array, model: Any, start: dict[str, Array], watch: Callable) -> tuple[State, Any]:
        bound, engine, ctrl = self.problem.bound, self.engine, self.engine.origin.ctrl
        model, start = bound.place(x, model, start)
        given = bound.controls(x) if bound.controls else ctrl

        controls = (lambda *now: given(engine.state(model, *now))) if callable(given) else given
        now = engine.begin(model, start), ctrl
        now, seen = engine.run(model, now, controls, self.problem.steps, bound.every, self._checkpoint, watch)
        return engine.state(model, *now), seen


@functools.lru_cache(maxsize=64)
def _program(problem: Problem, engine: str, options: tuple, checkpoint: int | None, _dtype: str) -> _Program:
    return _Program(problem, make_engine(problem, engine, **dict(options)), checkpoint)


def objective(
    problem: str | Problem, engine: str = "mjx", *, checkpoint: Any = None, simulator: str = "", **options: Any
) -> Objective:
    """J(x) of a problem, a JAX function of its variables x [n]. Equal calls share one compiled function.

    Args:
      problem: a Problem, or the name of one: "flip" or "grasp".
      engine: "mjx" for any scene (option `differentiation="implicit" | "saltation" | "native"`, see `tog.step`);
        "mujoco", C MuJoCo, for any scene, also one that MJX refuses, and variables that move no model (its costs see
        what a State holds, and no forces);
        "penalty" (options `friction="mujoco" | "paper"` and `differentiation="native" | "saltation"`) or "released"
        (option `mended`, one quirk out of `tog_mjx.paper.released.MENDED`) for those of one box and its fingers.
        `simulator` is its older name.
      checkpoint: keep the state only every so many steps for reverse mode and compute the rest again; a divisor of the
        steps, and a multiple of those for which a policy's controls are held.

    Its precision is that of JAX's x64 flag where it is called.

    Raises:
      InputError: for an unknown name or option, and a scene or variables that the engine cannot move.
    """
    problem, engine = get_problem(problem), older(engine, simulator)
    check_engine(problem, engine, options)
    steps, every = problem.steps, problem.bound.every
    if checkpoint is not None and (steps % require_whole("checkpoint", checkpoint, 1, steps) or checkpoint % every):
        raise InputError(f"checkpoint is {checkpoint}: give a divisor of {steps} steps, and a multiple of {every}")
    return Objective(problem, engine, tuple(sorted(options.items())), checkpoint)


def rollout(problem: str | Problem, x: Numbers, engine: str = "mjx", *, simulator: str = "", **options: Any) -> Motion:
    """The motion of a problem under its variables x [n]; arguments and errors are those of `objective`."""
    return objective(problem, engine, simulator=simulator, **options).motion(x)


def older(engine: Any, simulator: str | None) -> Any:
    """The engine's name, which may be given by the older word for it."""
    if simulator:
        warnings.warn("simulator= is the older name of engine=, and will go", DeprecationWarning, stacklevel=3)
    return simulator or engine


def final_cost(problem: Problem, engine: Engine | Simulator, x: Float[Array, " n"]) -> Scalar:
    """J on an engine of one's own, or on a planar simulator, which may be a traced pytree: J is differentiable in its
    parameters too."""
    program = _Program(problem, engine if isinstance(engine, Engine) else on_plane(problem, engine))
    return program.cost(x, program.engine.model, program.origin)


def trajectory(problem: Problem, simulator: Simulator, x: Float[Array, " n"]) -> Motion:
    """The whole motion on a planar simulator of one's own, the initial state first."""
    program = _Program(problem, on_plane(problem, simulator))
    return program.whole(x, program.engine.model, program.origin)[0]
