"""The compiled functions of a problem on an engine: its cost, and its motion."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.engines.engine import Engine, make_engine
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.problems.state import State
from tog_mjx.running.types import Scalar
from tog_mjx.running.user_code import number
from tog_mjx.stepping.mjx_state import START


class Motion(NamedTuple):
    """States at `time` [T] (s), T = steps + 1: qpos [T, nq], qvel [T, nv], act [T, na], and the controls in force, ctrl
    [T, nu].

    Of a scene of one box and its fingers also box [T, 6] (x, z, theta, vx, vz, omega) and fingers [T, F, 4] (x, z, vx,
    vz), else None.

    Units: the model's, SI where it is; `time` in s.
    Gradient: as `tog.objective` says, in the variables of the problem.
    """

    time: Float[Array, " T"]
    qpos: Float[Array, "T nq"]
    qvel: Float[Array, "T nv"]
    ctrl: Float[Array, "T nu"]
    box: Any = None
    fingers: Any = None
    act: Any = None


class Program:
    """The functions of x behind an objective."""

    def __init__(self, problem: Problem, engine: Engine, checkpoint: int | None = None):
        self.problem, self.engine, self._checkpoint = problem, engine, checkpoint
        self.origin = {name: getattr(engine.origin, name) for name in START}
        self.costs = jax.jit(self._costs, static_argnums=2)
        self.mean = jax.jit(self._mean)
        self.motion = jax.jit(self._motions)

    def cost(self, x: Array, model: Any, start: dict[str, Array]) -> Scalar:
        return self._total(*self._roll(x, model, start, self._running))

    def whole(self, x: Array, model: Any, start: dict[str, Array]) -> tuple[Motion, Scalar]:
        """The motion, and its cost."""

        def now(state: State) -> Motion:
            return Motion(state.time, state.qpos, state.qvel, state.ctrl, act=state.act)

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

    def _costs(self, x: Array, key: Key[Array, ""] | None, count: int | None) -> Float[Array, " count"]:
        key = jax.random.key(0) if key is None else key  # Made in here it is compiled only where it draws starts.
        return self._from_starts(functools.partial(self.cost, x), key, count)

    def _mean(self, x: Array, key: Key[Array, ""] | None) -> Scalar:
        return self._costs(x, key, None).mean()

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
def _program(problem: Problem, engine: str, options: tuple, checkpoint: int | None, _dtype: str) -> Program:
    return Program(problem, make_engine(problem, engine, **dict(options)), checkpoint)


def program(problem: Problem, engine: str, options: tuple = (), checkpoint: int | None = None) -> Program:
    """Equal calls share one, in each precision."""
    return _program(problem, engine, options, checkpoint, str(jnp.result_type(float)))
