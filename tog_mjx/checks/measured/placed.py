"""The variables of a scene function on C MuJoCo, in NumPy: where motions start, and what is held during them."""

from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.held import Layout
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.problems.wrt import Displacements
from tog_mjx.stepping.mjx_state import MOVING
from tog_mjx.stepping.tangents import state_basis
from tog_mjx.stepping.velocity_space import position_basis, turns

STARTED = ("ctrl", *MOVING)
"""Variables that are no numbers of what is held."""


class Given(NamedTuple):
    """States, controls and rows of what is held, see `engines.c_mujoco.forward`, of N motions; or, in place of N, the
    tangents of (qpos, qvel, act), of the controls and of the numbers of what is held, [., K]."""

    states: np.ndarray
    controls: np.ndarray
    held: np.ndarray


def layout_of(x: Displacements, model: mujoco.MjModel) -> Layout:
    """Of what is held of such a model. Raises InputError for numbers that C MuJoCo does not move."""
    moved = MovedModel.of(model)
    if x.parameter:
        moved = x.parameter.moved(moved, jnp.zeros(len(x.chosen)))
    return Layout(moved)


def starts(
    x: Displacements, forward: Forward, ctrl: Float[np.ndarray, " nu"], points: Float[np.ndarray, "N n"]
) -> Given:
    """At displacements."""
    (_, q, v, a), count = forward.ends, len(points)
    given = Given(*(np.tile(some, (count, 1)) for some in (forward.start, ctrl, forward.row)))
    n, pos, quat = forward.layout.ends
    if x.parameter:
        given.held[:, :n] += points
        return given
    change = np.zeros((count, x.mask.size))
    change[:, x.chosen] = points
    match x.array:
        case "ctrl":
            given.controls[:] += change
        case "qpos":
            for state, one in zip(given.states, change, strict=True):
                mujoco.mj_integratePos(forward.model, state[1:q], one, 1.0)
        case "qvel":
            given.states[:, q:v] += change
        case "act":
            given.states[:, v:a] += change
        case "mocap_pos":
            given.held[:, n:pos] += change
        case "mocap_quat":
            turned = given.held[:, pos:quat].reshape(-1, 4)
            for some, one in zip(turned, change.reshape(-1, 3), strict=True):
                mujoco.mju_quatIntegrate(some, one, 1.0)
            given.held[:, pos:quat] = turned.reshape(count, -1)
    return given


def tangents(
    x: Displacements, forward: Forward, state: Float[np.ndarray, " s"], directions: Float[np.ndarray, "n k"]
) -> Given:
    """Along the directions of x, then of each number of the start."""
    model, qpos, (n, pos, quat) = forward.model, state[1 : forward.ends[1]], forward.layout.ends
    sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu}
    sizes |= {"change": n, "mocap_pos": pos - n, "mocap_quat": quat - pos}
    moved = {name: np.zeros((size, directions.shape[1])) for name, size in sizes.items()}
    if x.parameter:
        moved["change"] = directions
    else:
        change = np.zeros((x.mask.size, directions.shape[1]))
        change[x.chosen] = directions
        match x.array:
            case "qpos":
                change = position_basis(model, qpos) @ change
            case "mocap_quat":
                of_each = turns(forward.row[pos:quat].reshape(-1, 4))
                change = np.einsum("bij, bjk -> bik", of_each, change.reshape(-1, 3, change.shape[1]))
        moved[x.array] = change.reshape(moved[x.array].shape)
    basis = state_basis(model, qpos).T
    parts = (MOVING, ("ctrl",), ("change", "mocap_pos", "mocap_quat"))
    along = [np.concatenate([moved[name] for name in names]) for names in parts]
    of_start = (basis, *(np.zeros((len(some), basis.shape[1])) for some in along[1:]))
    return Given(*(np.hstack(pair) for pair in zip(along, of_start, strict=True)))
