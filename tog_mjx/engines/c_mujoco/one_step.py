"""The derivative of steps by differences of `mj_step`: in what is held, and of the integrator that `mjd_transitionFD`
does not take in the state and the controls too."""

import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.stepping.velocity_space import position_basis, velocity_basis

Given = tuple[Float[np.ndarray, "N s"], Float[np.ndarray, "N nu"], Float[np.ndarray, "N h"]]
"""N states, the controls in them, and what is held."""
_TOGETHER = 2048
"""Steps of one batch, at most, unless those of one state are more."""


def one_step(
    forward: Forward, given: Given, step: float, of_states: bool, of_held: bool
) -> Float[np.ndarray, "2 N r m"]:
    """Derivatives of (time, qpos, qvel, act) ahead and behind, in velocity space, and in (qpos, qvel, act, ctrl) and in
    the directions of what is held, or in those of either alone; `step` is in each one's unit."""
    model, (states, controls, held) = forward.model, given
    n = 2 * model.nv + model.na
    counts = (n, model.nu) if of_states else (0, 0)
    m = sum(counts) + (forward.layout.directions if of_held else 0)
    ways = np.concatenate([np.zeros((1, m)), step * np.eye(m), -step * np.eye(m)])
    along = [*np.split(ways, np.cumsum(counts), axis=1)]
    found = np.empty((2, len(states), 1 + n, m))
    size = max(1, _TOGETHER // len(ways))
    for first in range(0, len(states), size):
        some = slice(first, first + size)
        after = _after(forward, states[some], controls[some], held[some], along)
        change = _in_velocity_space(forward, after).swapaxes(1, 2) / step
        found[0, some], found[1, some] = change[..., 1 : 1 + m], -change[..., 1 + m :]
    return found


def _after(
    forward: Forward, states: np.ndarray, controls: np.ndarray, held: np.ndarray, along: list[np.ndarray]
) -> Float[np.ndarray, "N S s"]:
    """The states after a step from each state, displaced in each of S ways."""
    of_state, of_controls, of_held = along
    count, ways = len(states), len(of_state)
    moved = np.repeat(states[:, None], ways, axis=1)
    controls = np.repeat(controls[:, None], ways, axis=1)
    if of_state.shape[1]:
        nv, (_, q, _, last) = forward.model.nv, forward.ends
        basis = position_basis(forward.model, states[:, 1:q])
        moved[..., 1:q] += (basis @ of_state[:, :nv].T).swapaxes(1, 2)
        moved[..., q:last] += of_state[:, nv:]
        controls += of_controls
    rows = forward.layout.displaced(held, of_held) if of_held.shape[1] else np.repeat(held[:, None], ways, axis=1)
    total = count * ways
    # A power of two: few sizes of batches are kept.
    with forward.batch(1 << (total - 1).bit_length(), rows.reshape(total, -1)) as batch:
        batch.state[:total, : states.shape[1]] = moved.reshape(total, -1)
        batch.ctrl[:total] = controls.reshape(total, -1)
        batch.step(np.arange(total))
        return batch.state[:total, : states.shape[1]].reshape(count, ways, -1).copy()


def _in_velocity_space(forward: Forward, after: Float[np.ndarray, "N S s"]) -> Float[np.ndarray, "N S r"]:
    """The differences of states from the first one."""
    _, q, _, last = forward.ends
    change = (after - after[:, :1])[..., :last]
    if forward.model.nq == forward.model.nv:
        return change
    turned = change[..., 1:q] @ velocity_basis(forward.model, after[:, 0, 1:q]).swapaxes(1, 2)
    return np.concatenate([change[..., :1], turned, change[..., q:]], axis=2)
