"""A problem's cost as a function of its variables, and its motions."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from tog_mjx.engines.engine import Engine, make_engine
from tog_mjx.engines.loop import Loop
from tog_mjx.problems.problem import Cost, Problem
from tog_mjx.problems.starts import Starts
from tog_mjx.problems.state import State
from tog_mjx.running.errors import InputError, require_whole
from tog_mjx.running.types import Numbers, Scalar
from tog_mjx.running.user_code import call, real
from tog_mjx.stepping.mjx_state import MOVING


class Motion(NamedTuple):
    """States at `time` [T] (s), T = steps + 1: qpos [T, nq], qvel [T, nv], and the controls in force, ctrl [T, nu]."""

    time: Float[Array, " T"]
    qpos: Float[Array, "T nq"]
    qvel: Float[Array, "T nv"]
    ctrl: Float[Array, "T nu"]


class Objective:
    """J(x) of a problem on an engine: a JAX function, to jit, vmap and differentiate in both modes.

    Of a problem with `Starts` J is the mean over starts, drawn by `key`; without one always the same.
    """

    def __init__(self, problem: Problem, engine: Engine, checkpoint: int | None):
        self.problem, self.engine, self._checkpoint = problem, engine, checkpoint
        self.__name__ = f"J of {problem.scene.name}"
        self._jitted_costs = jax.jit(self._costs, static_argnums=2)
        self._jitted_motion = jax.jit(self._motion)
        self._jitted_motions = jax.jit(lambda x, key: self._from_starts(functools.partial(self._motion, x), key))

    def __call__(self, x: Numbers, key: Key[Array, ""] | None = None) -> Scalar:
        """J at x [n]; raises InputError for an x of another shape, and a cost that fails."""
        return self.each(x, jax.random.key(0) if key is None else key).mean()

    def each(self, x: Numbers, key: Key[Array, ""], count: int | None = None) -> Float[Array, " count"]:
        """The cost of each start that the key draws, so many of them or the problem's own number; of a problem with one
        start that one [1]."""
        return self._jitted_costs(self.problem.check(x), key, count)

    def motion(self, x: Numbers, key: Key[Array, ""] | None = None) -> Motion:
        """The motion under x; with a key those of the starts that it draws, with a leading axis."""
        x = self.problem.check(x)
        if key is None:
            return self._jitted_motion(x, self.engine.model, self._origin)
        return self._jitted_motions(x, key)

    @property
    def _origin(self) -> dict[str, Array]:
        return {name: getattr(self.engine.origin, name) for name in MOVING}

    def _costs(self, x: Array, key: Key[Array, ""], count: int | None) -> Float[Array, " count"]:
        return self._from_starts(functools.partial(self._cost, x), key, count)

    def _from_starts(self, function: Callable[..., Any], key: Key[Array, ""], count: int | None = None) -> Any:
        starts, model, origin = self.problem.start, self.engine.model, self._origin
        if not isinstance(starts, Starts):
            return jax.tree.map(lambda leaf: leaf[None], function(model, origin))
        placed, fields = starts.draw(key, starts.count if count is None else count, model, origin)

        def one(placed: dict[str, Array], fields: dict[str, Array]) -> Any:
            return function(model.tree_replace(fields), {**origin, **placed})

        return jax.vmap(one)(placed, fields)

    def _cost(self, x: Array, model: Any, start: dict[str, Array]) -> Scalar:
        problem, total = self.problem, jnp.zeros(())
        watch = functools.partial(_number, problem.running_cost, "running_cost") if problem.running_cost else None
        last, seen = self._roll(x, model, start, watch)
        if problem.running_cost:
            total = total + seen.mean()
        return total + _number(problem.cost, "cost", last) if problem.cost else total

    def _motion(self, x: Array, model: Any, start: dict[str, Array]) -> Motion:
        def watch(state: State) -> Motion:
            return Motion(state.time, state.qpos, state.qvel, state.ctrl)

        last, seen = self._roll(x, model, start, watch)
        return jax.tree.map(lambda rows, row: jnp.concatenate([rows, row[None]]), seen, watch(last))

    def _roll(self, x: Array, model: Any, start: dict[str, Array], watch: Callable | None) -> tuple[State, Any]:
        bound, ctrl = self.problem.bound, self.engine.origin.ctrl
        model, start = bound.place(x, model, start)
        loop = Loop(
            step=functools.partial(self.engine.step, model),
            state=functools.partial(self.engine.state, model),
            controls=bound.controls(x) if bound.controls else ctrl,
            every=bound.every,
            watch=watch or (lambda _: None),
        )
        now, seen = loop.run((self.engine.begin(model, start), ctrl), self.problem.steps, self._checkpoint)
        return loop.state(*now), seen


def _number(cost: Cost, what: str, state: State) -> Scalar:
    found = real(what, call(f"{what} fails", cost, state), "one number")
    if found.shape != ():
        raise InputError(f"{what} returns an array of shape {list(found.shape)}; give one number")
    return found


@functools.lru_cache(maxsize=64)
def _objective(problem: Problem, engine: str, options: tuple, checkpoint: int | None, _dtype: str) -> Objective:
    return Objective(problem, make_engine(problem, engine, **dict(options)), checkpoint)


def objective(problem: Problem, engine: str = "mjx", checkpoint: int | None = None, **options: str) -> Objective:
    """J of a problem, see `Objective`. Its precision is that of JAX's x64 flag at this call; equal calls share it.

    Args:
      engine: "mjx" for any scene (option `differentiation`, see `tog.step`), "penalty" or "released" for those of one
        box and its fingers, with the options of `tog.make_simulator`.
      checkpoint: keep the state only every so many steps for reverse mode and compute the rest again; a divisor of the
        steps, and a multiple of those for which a policy's controls are held.

    Raises:
      InputError: for an unknown name or option, and a scene or variables that the engine cannot move.
    """
    steps, every = problem.steps, problem.bound.every
    if checkpoint is not None and (steps % require_whole("checkpoint", checkpoint, 1, steps) or checkpoint % every):
        raise InputError(f"checkpoint is {checkpoint}: give a divisor of {steps} steps, and a multiple of {every}")
    return _objective(problem, engine, tuple(sorted(options.items())), checkpoint, str(jnp.zeros(0).dtype))
