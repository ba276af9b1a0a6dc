"""Positions, where a rotation has four numbers, and displacements in velocity space, where it has three."""

import mujoco
import numpy as np
from jaxtyping import Float

_TURNS = 0.5 * np.array(
    [
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, -1, 0], [0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ]
)
"""The derivative [4, 3] of a quaternion in a rotation vector of its own frame, by each of its numbers w, x, y, z."""


def turns(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4 3"]:
    """The derivative of quaternions in rotation vectors of their own frames."""
    return np.tensordot(quaternions, _TURNS, 1)


def position_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, "*batch nq"]) -> Float[np.ndarray, "*batch nq nv"]:
    """The derivative of the displaced positions in a displacement of velocity space."""
    basis = np.zeros((*qpos.shape, model.nv))
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
        if kind == free:
            basis[..., q : q + 3, v : v + 3] = np.eye(3)
            q, v = q + 3, v + 3
        if kind in (free, ball):
            basis[..., q : q + 4, v : v + 3] = turns(qpos[..., q : q + 4])
        else:
            basis[..., q, v] = 1.0
    return basis


def velocity_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, "*batch nq"]) -> Float[np.ndarray, "*batch nv nq"]:
    """The derivative of that displacement in the positions: of a unit quaternion, twice the part along the turn."""
    basis = position_basis(model, qpos)
    return (basis / np.maximum((basis**2).sum(-2, keepdims=True), 1e-30)).swapaxes(-1, -2)
