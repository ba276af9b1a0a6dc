"""The derivative of steps by differences of `mj_step`: in what is held, and of the integrator that `mjd_transitionFD`
does not take in the state and the controls too."""

import numpy as np
from jaxtyping import Float, Int

from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.stepping.velocity_space import position_basis, velocity_basis

Given = tuple[Float[np.ndarray, "N s"], Float[np.ndarray, "N nu"], Float[np.ndarray, "N h"]]
"""N states, the controls in them, and what is held."""
_IN_TURN, _TOGETHER = 16, 2048
"""How many states one model that has moved serves one after the other, and of how many models a batch is, at most
unless those of one state are more."""


def one_step(
    forward: Forward, given: Given, step: float, of_states: bool, of_held: bool
) -> Float[np.ndarray, "2 N r m"]:
    """Derivatives of (time, qpos, qvel, act) ahead and behind, in velocity space, and in (qpos, qvel, act, ctrl) and in
    the directions of what is held, or in those of either alone; `step` is in each one's unit."""
    states, controls, held = given
    n, nu = 2 * forward.model.nv + forward.model.na, forward.model.nu
    of_state, of_controls = (n, nu) if of_states else (0, 0)
    m = of_state + of_controls + (forward.layout.directions if of_held else 0)
    ways = np.concatenate([np.zeros((1, m)), step * np.eye(m), -step * np.eye(m)])
    along = np.split(ways, np.cumsum([of_state, of_controls]), axis=1)
    found = np.empty((2, len(states), 1 + n, m))
    pieces = _pieces(held, _IN_TURN if forward.layout.moves_model else 1)
    size = max(1, _TOGETHER // len(ways))
    for first in range(0, len(pieces) - 1, size):
        ends = pieces[first : first + size + 1]
        some = slice(ends[0], ends[-1])
        moved = _displaced(forward, states[some], controls[some], along)
        rows = held[ends[:-1]]
        rows = forward.layout.displaced(rows, along[2]) if of_held else np.repeat(rows[:, None], len(ways), axis=1)
        after = _after(forward, *moved, rows, ends - ends[0])
        change = _in_velocity_space(forward, after).swapaxes(1, 2) / step
        found[0, some], found[1, some] = change[..., 1 : 1 + m], -change[..., 1 + m :]
    return found


def _pieces(held: Float[np.ndarray, "N h"], longest: int) -> Int[np.ndarray, " P"]:
    """Where stretches begin in which the same is held, and the end of the last one."""
    fresh = np.flatnonzero((held[1:] != held[:-1]).any(1)) + 1
    runs = np.split(np.arange(len(held)), fresh)
    return np.concatenate([*(run[::longest] for run in runs), [len(held)]]).astype(int)


def _displaced(
    forward: Forward, states: np.ndarray, controls: np.ndarray, along: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Each state and its controls, displaced in each of S ways, [N, S, s] and [N, S, nu]."""
    of_state, of_controls, _ = along
    states, controls = (np.repeat(some[:, None], len(of_state), axis=1) for some in (states, controls))
    if of_state.shape[1]:
        nv, (_, q, _, last) = forward.model.nv, forward.ends
        basis = position_basis(forward.model, states[:, 0, 1:q])
        states[..., 1:q] += (basis @ of_state[:, :nv].T).swapaxes(1, 2)
        states[..., q:last] += of_state[:, nv:]
        controls += of_controls
    return states, controls


def _after(
    forward: Forward,
    states: Float[np.ndarray, "N S s"],
    controls: Float[np.ndarray, "N S nu"],
    rows: Float[np.ndarray, "P S h"],
    ends: Int[np.ndarray, " P1"],
) -> Float[np.ndarray, "N S s"]:
    """The states after one step each, in P stretches of states of which each holds the same in each of S ways."""
    (_, ways, s), after = states.shape, np.empty_like(states)
    lengths = np.diff(ends)
    # A power of two: few sizes of batches are kept.
    with forward.batch(1 << (len(rows) * ways - 1).bit_length(), rows.reshape(len(rows) * ways, -1)) as batch:
        for turn in range(lengths.max()):
            active = np.flatnonzero(lengths > turn)
            at, chosen = ends[active] + turn, (active[:, None] * ways + np.arange(ways)).ravel()
            batch.state[chosen, :s] = states[at].reshape(-1, s)
            batch.ctrl[chosen] = controls[at].reshape(len(chosen), -1)
            batch.step(chosen)
            after[at] = batch.state[chosen, :s].reshape(-1, ways, s)
    return after


def _in_velocity_space(forward: Forward, after: Float[np.ndarray, "N S s"]) -> Float[np.ndarray, "N S r"]:
    """The differences of states from the first one."""
    _, q, _, last = forward.ends
    change = (after - after[:, :1])[..., :last]
    if forward.model.nq == forward.model.nv:
        return change
    turned = change[..., 1:q] @ velocity_basis(forward.model, after[:, 0, 1:q]).swapaxes(1, 2)
    return np.concatenate([change[..., :1], turned, change[..., q:]], axis=2)
