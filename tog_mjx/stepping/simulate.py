"""Any MJX model over many steps, differentiable, in a few lines of a user's own."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tog_mjx.running.errors import InputError, require_choice, require_kind, require_whole
from tog_mjx.running.types import Scalar
from tog_mjx.stepping import loop, randomised
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.implicit import STEPS, sensed
from tog_mjx.stepping.mjx_state import require_on_mjx, require_state, state_of

Policy = Callable[[mjx.Data, Scalar], Any]
"""(state, time) to controls [nu]."""


def positions_and_velocities(data: mjx.Data) -> tuple[Float[Array, " nq"], Float[Array, " nv"]]:
    """What `simulate` observes unless told otherwise."""
    return data.qpos, data.qvel


def simulate(
    model: mjx.Model,
    data: mjx.Data,
    controls: Float[Array, "*shape nu"] | Policy,
    steps: int,
    *,
    differentiation: str = "implicit",
    observe: Callable[[mjx.Data], Any] = positions_and_velocities,
    checkpoint: int | None = None,
) -> tuple[mjx.Data, Any]:
    """Simulates `steps` time steps from `data`. Works under jit, vmap, grad, jvp and inside scan.

    The loop carries the state, see `tog_mjx.stepping.mjx_state`; the other inputs in `data` (applied forces, mocap
    poses, active equalities) stay as they are given.

    Args:
      model, data: on MJX's JAX implementation. A batch: every array of `data` with a leading axis [B, ...]; and of the
        model, where its members differ in it (domain randomisation, by `model.tree_replace` or `jax.vmap`).
      controls: constant [nu], or one row a step [steps, nu]; for a batch also [B, nu] or [B, steps, nu]. Or a function
        `controls(state, time)` that returns [nu], called at the beginning of each step: `time` is in s, and `state` is
        the mjx.Data as MuJoCo's control callback sees it. What follows from positions and velocities is that of this
        moment (poses, Jacobians, contacts, their sensors); accelerations and forces are not known yet. Of a batch it
        sees one member.
      steps: positive number of time steps.
      differentiation: "implicit", "saltation" (with the jumps of touch-downs) or "native", see `tog.step`.
      observe: what to record of the data after each step, a pytree of arrays.
      checkpoint: keep the state only every so many steps for reverse mode and recompute the rest: memory falls from
        O(steps) to O(steps / checkpoint + checkpoint), time grows by one forward run. Must divide `steps`.

    Returns:
      (data, observations): `data` with the last state and controls (derived quantities are not updated), and what
      `observe` returned, with a leading axis [steps, ...]; for a batch both with a leading axis [B, ...].

    Raises:
      InputError: for an unknown differentiation, data of another model, batches of two sizes, controls of the wrong
        shape or of one that means two things, or a checkpoint that does not divide the steps.

    Units: the model's; `time` is in s.
    Gradient: as that of `tog.step`, through all steps and a function that gives controls.
    Source: as `tog.step`.
    """
    require_choice("differentiation", differentiation, STEPS)
    require_on_mjx(model, data)
    require_kind("observe", observe, Callable, "give a function of mjx.Data")
    steps = require_whole("steps", steps, 1)
    if checkpoint is not None and steps % require_whole("checkpoint", checkpoint, 1):
        raise InputError(f"checkpoint is {checkpoint}: give a divisor of the {steps} steps")
    if not callable(controls):
        controls = _array("controls are", controls, model, data)
    if data.qpos.ndim == 2:
        return _simulate_batch(model, data, controls, steps, differentiation, observe, checkpoint)
    require_state(model, data)

    def advance(state: dict[str, Array], ctrl: Array) -> tuple[dict[str, Array], Any]:
        after = STEPS[differentiation](model, data.replace(**state, ctrl=ctrl))
        return state_of(after), observe(after)

    def ask(state: dict[str, Array], ctrl: Array) -> Array:
        before = data.replace(**state, ctrl=ctrl)
        found = _array("controls(state, time) returns", policy(sensed(model, before), before.time), model, before)
        if found.shape != (model.nu,):
            raise InputError(f"controls(state, time) returns an array of shape {found.shape}; give [{model.nu}]")
        return found

    policy: Any = controls
    if callable(controls):
        controls = jax.checkpoint(ask, prevent_cse=False)  # Else reverse mode keeps what follows from every state.
    elif controls.shape not in ((model.nu,), (steps, model.nu)):
        raise InputError(f"controls have shape {controls.shape}; give [{model.nu}] or [{steps}, {model.nu}]")
    (state, ctrl), observations = loop.run(advance, controls, (state_of(data), data.ctrl), steps, checkpoint=checkpoint)
    return data.replace(**state, ctrl=ctrl), observations


def _array(what: str, given: Any, model: mjx.Model, data: mjx.Data) -> Array:
    try:
        if given is not None:
            return jnp.asarray(given, data.ctrl.dtype)
    except (TypeError, ValueError):
        pass
    raise InputError(f"{what} no array of numbers; give one of shape [{model.nu}]")


def _simulate_batch(model, data, controls, steps, differentiation, observe, checkpoint) -> tuple[mjx.Data, Any]:
    batch, axis = data.qpos.shape[0], None
    for name, (members, *_) in randomised.batched_fields(model).items():
        if members != batch:
            raise InputError(f"{name} of the model has {members} members, and the data {batch}: give as many of both")
    if not callable(controls):
        if (batch, model.nu) == controls.shape == (steps, model.nu):
            told = f"controls of shape {controls.shape} are one row a step, or one a member of the batch: both are "
            raise InputError(f"{told}{steps}; give [{batch}, {steps}, {model.nu}], by jnp.broadcast_to or jnp.repeat")
        axis = None if controls.shape in ((model.nu,), (steps, model.nu)) else 0
        if axis == 0 and controls.shape not in ((batch, model.nu), (batch, steps, model.nu)):
            shapes = f"[{model.nu}], [{steps}, {model.nu}], [{batch}, {model.nu}] or [{batch}, {steps}, {model.nu}]"
            raise InputError(f"controls have shape {controls.shape}; give {shapes}")
    rows = controls if axis == 0 else None

    def one(model: mjx.Model, data: mjx.Data, rows: Array | None) -> tuple[mjx.Data, Any]:
        options: dict[str, Any] = {"differentiation": differentiation, "observe": observe, "checkpoint": checkpoint}
        return simulate(model, data, controls if rows is None else rows, steps, **options)

    return jax.vmap(one, (randomised.in_axes(model), 0, axis))(model, data, rows)
