"""What moves a problem: MJX and C MuJoCo any scene, and the planar simulators those of one box and its fingers.

    carry = engine.begin(model, start)          start by the names of its fields in `mjx.Data`
    carry, state = engine.step(model, carry, ctrl)   `state` is the State in which the step begins
    state = engine.state(model, carry, ctrl)    after the last step, or before a control is known
    (carry, ctrl), seen = engine.run(model, (carry, ctrl), controls, steps, every, checkpoint, watch)

The model is an argument, so that variables can move it.
"""

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines.c_mujoco.forward import Forward, check_state
from tog_mjx.engines.c_mujoco.held import Held
from tog_mjx.engines.c_mujoco.observe import Observed
from tog_mjx.engines.c_mujoco.sweep import motion
from tog_mjx.engines.simulator import Simulator, check_names, make_simulator
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.mjcf.scene import Scene
from tog_mjx.mjcf.supported import check_supported
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.state import State
from tog_mjx.running.errors import InputError
from tog_mjx.stepping import loop
from tog_mjx.stepping._mjx import mjx, put_model
from tog_mjx.stepping.complete import completed
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import MOCAP, START, on_mjx, state_of

Controls = Float[Array, " nu"]


@dataclass(frozen=True, eq=False)
class Engine(abc.ABC):
    """See the module's header."""

    scene: Scene
    model: Any
    origin: Any

    @abc.abstractmethod
    def begin(self, model: mjx.Model, start: dict[str, Array]) -> Any: ...

    @abc.abstractmethod
    def step(self, model: mjx.Model, carry: Any, ctrl: Controls) -> tuple[Any, State]: ...

    @abc.abstractmethod
    def state(self, model: mjx.Model, carry: Any, ctrl: Controls) -> State: ...

    def run(
        self,
        model: mjx.Model,
        now: loop.Now,
        controls: Array | loop.Law,
        steps: int,
        every: int,
        checkpoint: int | None,
        watch: Callable[[State], Any],
    ) -> tuple[loop.Now, Any]:
        """As `loop.run`; what is kept is what `watch` sees of the State in which each step begins."""

        def step(carry: Any, ctrl: Array) -> tuple[Any, Any]:
            carry, state = self.step(model, carry, ctrl)
            return carry, watch(state)

        return loop.run(step, controls, now, steps, every, checkpoint)


@dataclass(frozen=True, eq=False)
class OnMjx(Engine):
    """Any scene that MJX can simulate."""

    differentiation: str

    def begin(self, model: mjx.Model, start: dict[str, Array]) -> dict[str, Array]:
        data = self.origin.replace(**start)
        return {**state_of(data), **{name: getattr(data, name) for name in MOCAP if model.nmocap}}

    def step(self, model: mjx.Model, carry: dict[str, Array], ctrl: Controls) -> tuple[dict[str, Array], State]:
        after = STEPS[self.differentiation](model, self.origin.replace(**carry, ctrl=ctrl))
        if model.opt.integrator == mjx.IntegratorType.RK4:  # What it derives is of its last stage.
            return {**carry, **state_of(after)}, self.state(model, carry, ctrl)
        # What a step derives is of the moment in which it begins; only the state itself has moved on.
        now = after.replace(**carry)
        state = State.of(self.scene.model, now, lambda: now, lambda: completed(model, now))
        return {**carry, **state_of(after)}, state

    def state(self, model: mjx.Model, carry: dict[str, Array], ctrl: Controls) -> State:
        now = self.origin.replace(**carry, ctrl=ctrl)
        return State.at(self.scene.model, model, now, self.differentiation)


@dataclass(frozen=True, eq=False)
class OnPlane(Engine):
    """A scene of one box and its fingers, on a planar simulator; MJX only says where its bodies and sites are."""

    simulator: Simulator

    def begin(self, model: mjx.Model, start: dict[str, Array]) -> tuple[Any, Array]:
        del model
        return self.simulator.init(*self.scene.planar(start["qpos"], start["qvel"])), jnp.zeros((), int)

    def step(self, model: mjx.Model, carry: tuple[Any, Array], ctrl: Controls) -> tuple[tuple[Any, Array], State]:
        planar, steps = carry
        after = self.simulator.step(planar, ctrl[jnp.asarray(self.scene.actuators)])
        return (after, steps + 1), self.state(model, carry, ctrl)

    def state(self, model: mjx.Model, carry: tuple[Any, Array], ctrl: Controls) -> State:
        planar, steps = carry
        time = self.origin.time + steps * self.scene.model.opt.timestep
        joints, (q, v) = jnp.asarray(self.scene.joints), self.scene.of_joints(*self.simulator.observe(planar))
        qpos, qvel = self.origin.qpos.at[joints].set(q), self.origin.qvel.at[joints].set(v)
        now = self.origin.replace(time=time, qpos=qpos, qvel=qvel, ctrl=ctrl)
        return State.of(self.scene.model, now, lambda: mjx.kinematics(model, now), _no_forces)


@dataclass(frozen=True, eq=False)
class OnMujoco(Engine):
    """Any scene, on C MuJoCo; its model is a `MovedModel`."""

    forward: Forward

    def begin(self, model: MovedModel, start: dict[str, Array]) -> tuple[Array, Held]:
        s = jnp.asarray(self.forward.start, self.origin.qpos.dtype)
        time, *_, warm = jnp.split(s, self.forward.ends)
        held = Held.of(model, start)
        return jnp.concatenate([time, start["qpos"], start["qvel"], start["act"], warm]), held

    def step(self, model: MovedModel, carry: tuple[Array, Held], ctrl: Controls) -> tuple[tuple[Array, Held], State]:
        s, held = carry
        after = motion(self.forward.holding(model), s, ctrl[None], held)[0]
        return (after, held), self.state(model, carry, ctrl)

    def state(self, model: MovedModel, carry: tuple[Array, Held], ctrl: Controls) -> State:
        s, held = carry
        time, qpos, qvel, act, _ = jnp.split(s, self.forward.ends)
        seen = Observed(self.forward.holding(model), s, ctrl, held)
        return State(time[0], qpos, qvel, act, ctrl, self.scene.model, seen)

    def run(
        self,
        model: Any,
        now: loop.Now,
        controls: Array | loop.Law,
        steps: int,
        every: int,
        checkpoint: int | None,
        watch: Callable[[State], Any],
    ) -> tuple[loop.Now, Any]:
        forward = self.forward.holding(model)

        def stretch(carry: tuple[Array, Held], rows: Float[Array, "k nu"]) -> tuple[tuple[Array, Held], Any]:
            s, held = carry
            after = motion(forward, s, rows, held)
            before = jnp.concatenate([s[None], after[:-1]])
            seen = jax.vmap(lambda s, ctrl: watch(self.state(model, (s, held), ctrl)))(before, rows)
            return (after[-1], held), seen

        return loop.run_stretches(stretch, controls, now, steps, every, checkpoint)


def _no_forces() -> mjx.Data:
    raise InputError("this engine has no mjx.Data: its forces are its own; take what a State holds, or engine mjx")


def check_engine(problem: Problem, name: str, options: Mapping[str, str]) -> None:
    """Raises InputError for an unknown name or option, and for a scene or variables that the engine cannot move."""
    check_names(name, options)
    if name == "mujoco":
        check_state(problem.scene.model, problem.scene.name)
        return
    check_supported(problem.scene.model, problem.scene.name)
    if name == "mjx":
        return
    _ = problem.scene.physics  # What it lacks is told.
    if problem.bound.moves_model:
        raise InputError(f"engine {name} reads its parameters from the scene, and variables move none; take mjx")


def make_engine(problem: Problem, name: str, **options: str) -> Engine:
    """The engine of that name, for a problem; errors are those of `check_engine`."""
    check_engine(problem, name, options)
    if name == "mujoco":
        return _on_mujoco(problem, **options)
    if name == "mjx":
        return OnMjx(problem.scene, *_on_mjx(problem), options.get("differentiation", "implicit"))
    return on_plane(problem, make_simulator(name, problem.scene, **options))


def on_plane(problem: Problem, simulator: Simulator) -> Engine:
    """A planar simulator as the engine of a problem."""
    return OnPlane(problem.scene, *_on_mjx(problem), simulator)


def _on_mujoco(problem: Problem, differentiation: str = "implicit") -> Engine:
    model, start = problem.scene.model, problem.origin
    with jax.ensure_compile_time_eval():
        # Copies: on a CPU JAX may share the memory of an array, which MuJoCo writes to.
        origin = {name: jnp.asarray(np.array(getattr(start, name)), float) for name in (*START, "ctrl")}
        moved = MovedModel.of(model)
    forward = Forward(model, start, differentiation=differentiation)
    return OnMujoco(problem.scene, moved, SimpleNamespace(**origin), forward)


def _on_mjx(problem: Problem) -> tuple[mjx.Model, mjx.Data]:
    with jax.ensure_compile_time_eval():
        model = put_model(problem.scene.model)
        return model, on_mjx(model, problem.origin)
