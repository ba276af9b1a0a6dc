"""Any MJX model over many steps, differentiable, in a few lines of a user's own."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tog_mjx._mjx import mjx
from tog_mjx.errors import InputError, require_choice, require_kind, require_whole
from tog_mjx.implicit import STEPS
from tog_mjx.state import require_on_mjx, require_state, state_of


def positions_and_velocities(data: mjx.Data) -> tuple[Float[Array, " nq"], Float[Array, " nv"]]:
    """What `simulate` observes unless told otherwise."""
    return data.qpos, data.qvel


def simulate(
    model: mjx.Model,
    data: mjx.Data,
    controls: Float[Array, "*shape nu"],
    steps: int,
    *,
    differentiation: str = "implicit",
    observe: Callable[[mjx.Data], Any] = positions_and_velocities,
    checkpoint: int | None = None,
) -> tuple[mjx.Data, Any]:
    """Simulates `steps` time steps from `data`. Works under jit, vmap, grad, jvp and inside scan.

    The loop carries the state, see `tog_mjx.state`; the other inputs in `data` (applied forces, mocap poses, active
    equalities) stay as they are given.

    Args:
      model, data: on MJX's JAX implementation. A batch: every array of `data` with a leading axis [B, ...].
      controls: constant [nu], or one row a step [steps, nu]; for a batch also [B, nu] or [B, steps, nu].
      steps: positive number of time steps.
      differentiation: "implicit", "saltation" (with the jumps of touch-downs) or "native", see `tog.step`.
      observe: what to record of the data after each step, a pytree of arrays.
      checkpoint: keep the state only every so many steps for reverse mode and recompute the rest: memory falls from
        O(steps) to O(steps / checkpoint + checkpoint), time grows by one forward run. Must divide `steps`.

    Returns:
      (data, observations): `data` with the last state (derived quantities are not updated), and what `observe`
      returned, with a leading axis [steps, ...]; for a batch both with a leading axis [B, ...].

    Raises:
      InputError: for an unknown differentiation, data of another model, controls of the wrong shape or of one that
        means two things, or a checkpoint that does not divide the steps.
    """
    require_choice("differentiation", differentiation, STEPS)
    require_on_mjx(model, data)
    require_kind("observe", observe, Callable, "give a function of mjx.Data")
    steps = require_whole("steps", steps, 1)
    if checkpoint is not None and steps % require_whole("checkpoint", checkpoint, 1):
        raise InputError(f"checkpoint is {checkpoint}: give a divisor of the {steps} steps")
    try:
        controls = jnp.asarray(controls, data.ctrl.dtype)
    except (TypeError, ValueError):
        raise InputError(f"controls are no array of numbers; give one of shape [{model.nu}]") from None
    if data.qpos.ndim == 2:
        return _simulate_batch(model, data, controls, steps, differentiation, observe, checkpoint)
    require_state(model, data)
    if controls.shape not in ((model.nu,), (steps, model.nu)):
        raise InputError(f"controls have shape {controls.shape}; give [{model.nu}] or [{steps}, {model.nu}]")

    def advance(state: dict[str, Array], ctrl: Array | None) -> tuple[dict[str, Array], Any]:
        before = data.replace(**state, ctrl=controls if ctrl is None else ctrl)
        after = STEPS[differentiation](model, before)
        return state_of(after), observe(after)

    rows = controls if controls.ndim == 2 else None
    state = state_of(data)
    if checkpoint is None:
        state, observations = jax.lax.scan(advance, state, rows, length=steps)
    else:
        segments = steps // checkpoint
        fold = jax.tree.map(lambda x: x.reshape(segments, checkpoint, *x.shape[1:]), rows)
        segment = jax.checkpoint(lambda state, rows: jax.lax.scan(advance, state, rows, length=checkpoint))
        state, observations = jax.lax.scan(segment, state, fold, length=segments)
        observations = jax.tree.map(lambda x: x.reshape(steps, *x.shape[2:]), observations)
    return data.replace(**state, ctrl=controls if rows is None else rows[-1]), observations


def _simulate_batch(model, data, controls, steps, differentiation, observe, checkpoint) -> tuple[mjx.Data, Any]:
    batch = data.qpos.shape[0]
    if (batch, model.nu) == controls.shape == (steps, model.nu):
        told = f"controls of shape {controls.shape} are one row a step, or one a member of the batch: both are {steps}"
        raise InputError(f"{told}; give [{batch}, {steps}, {model.nu}], by jnp.broadcast_to or jnp.repeat")
    shared = controls.shape in ((model.nu,), (steps, model.nu))
    if not shared and controls.shape not in ((batch, model.nu), (batch, steps, model.nu)):
        shapes = f"[{model.nu}], [{steps}, {model.nu}], [{batch}, {model.nu}] or [{batch}, {steps}, {model.nu}]"
        raise InputError(f"controls have shape {controls.shape}; give {shapes}")

    def one(data: mjx.Data, controls: Array) -> tuple[mjx.Data, Any]:
        options: dict[str, Any] = {"differentiation": differentiation, "observe": observe, "checkpoint": checkpoint}
        return simulate(model, data, controls, steps, **options)

    return jax.vmap(one, (0, None if shared else 0))(data, controls)
