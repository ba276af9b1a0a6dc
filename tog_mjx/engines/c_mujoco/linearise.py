"""The derivative of every step of a motion, by differences of C MuJoCo at its stored state, on all cores.

Both one-sided differences are taken; their mean is the centred one. Where they are far apart a contact begins or ends
within a step of the difference, and the mean would be a jump divided by that step. There both are taken again with a
smaller step, and if they are still apart the side counts that changes less with the step: it does not cross the jump.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco import inverse
from tog_mjx.engines.c_mujoco.forward import STATE, Forward, taken
from tog_mjx.engines.c_mujoco.one_step import Given, one_step
from tog_mjx.engines.c_mujoco.switching import Jumps
from tog_mjx.engines.c_mujoco.threads import for_each, on_all_cores
from tog_mjx.stepping.velocity_space import position_basis, velocity_basis

STEP, FINE = 1e-6, 1e-8
"""Of a difference, in each coordinate's unit, and where something begins within that. The mean errs by rounding, which
is 1e-14 / STEP of what has gone through a converged solver (flip), and by STEP^2 times a third derivative."""
APART = 1e-2
"""The difference of the two, relative to the flatter one and at least to 1, from which on something lies in between: of
what is smooth it is STEP times a second derivative, which in stiff contacts is a few thousand times the first one. A
jump that is overlooked is smaller than APART * STEP."""
NO_SECOND = "engine mujoco has first derivatives only; take engine mjx for second ones"


class Slopes(NamedTuple):
    """Of (qpos, qvel, act) after a step: in those before, [..., n, n], and in the controls, [..., n, nu]; of the time
    and those, in numbers of what is held, [..., 1 + n, m]."""

    state: np.ndarray
    controls: np.ndarray
    held: np.ndarray


def slopes(
    forward: Forward,
    before: Float[np.ndarray, "N s"],
    after: Float[np.ndarray, "N s"],
    controls: Float[np.ndarray, "N nu"],
    held: Float[np.ndarray, "N h"] | None = None,
    *,
    is_held: bool = False,
) -> Slopes:
    """The derivatives of N steps, with `is_held` those in what is held too. Each is computed from its own state alone,
    on whichever thread. Those of steps that burst are NaN."""
    forward = forward.precise
    model, (_, q, *_) = forward.model, forward.ends
    held = np.tile(forward.row, (len(before), 1)) if held is None else held
    usable = np.flatnonzero(np.isfinite(after).all(1) & np.isfinite(before).all(1))
    n, nu, m = 2 * model.nv + model.na, model.nu, forward.layout.directions if is_held else 0

    def given(rows: np.ndarray) -> Given:
        return before[rows], controls[rows], held[rows]

    def of_states(rows: np.ndarray, step: float) -> np.ndarray:
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            return one_step(forward, given(rows), step, True, False)
        return _transitions(forward, given(rows), step)

    def of_held(rows: np.ndarray, step: float) -> np.ndarray:
        return one_step(forward, given(rows), step, False, True)

    slope = np.full((len(before), 1 + n, n + nu + m), np.nan)
    rough = usable
    if inverse.is_for(forward):
        both, done = inverse.transitions(forward, given(usable), after[usable])
        is_smooth = done & ~_apart(both).any(1)
        slope[usable[is_smooth], :, : n + nu] = both[:, is_smooth].mean(0)
        rough = usable[~is_smooth]
    if rough.size:
        slope[rough, :, : n + nu] = centred(of_states, rough)
    if is_held:
        slope[usable, :, n + nu :] = centred(
            lambda rows, step: one_step(forward, given(rows), step, False, True), usable
        )
    if forward.differentiation == "saltation":
        jumps = _jumps(forward, given(usable), after[usable], is_held)
        slope[usable, 1:, : model.nv] += jumps[..., : model.nv]
        slope[usable, 1:, n + nu :] += jumps[..., model.nv :]
    in_held = slope[..., n + nu :]
    in_held = forward.layout.in_numbers(held, in_held) if is_held else in_held
    found = Slopes(slope[:, 1:, :n], slope[:, 1:, n : n + nu], in_held)
    if model.nq == model.nv:
        return found
    return _in_positions(model, before[:, 1:q], after[:, 1:q], found)


def _transitions(forward: Forward, given: Given, step: float) -> np.ndarray:
    """Derivatives by differences ahead and behind, [2, N, 1 + n, n + nu], in velocity space; the time's are zero."""
    states, controls, held = given
    model, count = forward.model, len(states)
    n = 2 * model.nv + model.na
    of_state, of_controls = np.empty((2, count, n, n)), np.zeros((2, count, n, model.nu))

    def one(data: mujoco.MjData, i: int) -> None:
        for side, length in enumerate((step, -step)):
            mujoco.mj_setState(data.model, data, states[i], STATE)
            data.ctrl[:] = controls[i]
            of = of_state[side, i], of_controls[side, i]
            mujoco.mjd_transitionFD(data.model, data, length, False, *of, None, None)

    for_each(forward, held, one)
    return np.pad(np.concatenate([of_state, of_controls], axis=3), ((0, 0), (0, 0), (1, 0), (0, 0)))


def _jumps(forward: Forward, given: Given, after: np.ndarray, is_held: bool) -> np.ndarray:
    """What touch-downs and partings add to the derivatives in the positions before and in the directions of what is
    held, [N, n, nv + m], in velocity space."""
    model, (states, controls, held) = forward.model, given
    m = forward.layout.directions if is_held else 0
    found = np.empty((len(states), 2 * model.nv + model.na, model.nv + m))

    def some(numbers: Iterable[int]) -> None:
        room = taken(forward.rooms, lambda: Jumps(forward))
        for i in numbers:
            found[i] = room.of_step(states[i], after[i], controls[i], held[i], is_held)
        forward.rooms.append(room)

    on_all_cores(forward, some, len(states))
    return found


def centred(one_sided: Callable[[np.ndarray, float], np.ndarray], members: np.ndarray) -> np.ndarray:
    """Derivatives [N, n, m] of these members, from differences of a length ahead and behind, [2, N, n, m]."""
    both = one_sided(members, STEP)
    slope, again = both.mean(0), _apart(both).any(1)
    coarse, fine = both[:, again], one_sided(members[again], FINE)
    slope[again] = np.where(_apart(coarse)[:, None], _settled(coarse, fine), slope[again])
    return slope


def _apart(both: Float[np.ndarray, "2 N n m"]) -> np.ndarray:
    """Of which variables the two differences disagree, [N, m]."""
    size = np.abs(both).max(2).min(0)
    return np.abs(both[0] - both[1]).max(1) > APART * np.maximum(size, 1.0)


def _settled(coarse: Float[np.ndarray, "2 N n m"], fine: Float[np.ndarray, "2 N n m"]) -> np.ndarray:
    """The mean with the small step, [N, n, m]; of variables that are apart even then, at a kink, the mean of its sides,
    and at a jump the side without it, or, if both sides jump, the slope beyond."""
    # Of the values at both steps of one side: what has jumped before either is in none of it.
    beyond = (STEP * coarse - FINE * fine) / (STEP - FINE)
    drift = np.linalg.norm(coarse - fine, axis=2)
    size = np.maximum(np.linalg.norm(beyond, axis=2), 1.0)
    is_kink = (drift <= APART * size).all(axis=0)
    steadier = np.where((drift[0] < drift[1])[:, None], *beyond)
    sides = np.where(is_kink[:, None], beyond.mean(0), steadier)
    return np.where(_apart(fine)[:, None], sides, fine.mean(0))


def _in_positions(model: mujoco.MjModel, before: np.ndarray, after: np.ndarray, found: Slopes) -> Slopes:
    """From velocity space, where a rotation has three numbers, to positions, where it has four."""
    nv = model.nv
    out_of = position_basis(model, after)

    def rows(matrix: np.ndarray) -> np.ndarray:
        return np.concatenate([out_of @ matrix[:, :nv], matrix[:, nv:]], axis=1)

    columns = columns_in_positions(model, before, found.state)
    held = np.concatenate([found.held[:, :1], rows(found.held[:, 1:])], axis=1)
    return Slopes(rows(columns), rows(found.controls), held)


def columns_in_positions(
    model: mujoco.MjModel, qpos: Float[np.ndarray, "N nq"], matrix: Float[np.ndarray, "N m k"]
) -> np.ndarray:
    """Derivatives in qpos and what follows, of those in velocity space and what follows."""
    if model.nq == model.nv:
        return matrix
    nv = model.nv
    return np.concatenate([matrix[..., :nv] @ velocity_basis(model, qpos), matrix[..., nv:]], axis=2)
