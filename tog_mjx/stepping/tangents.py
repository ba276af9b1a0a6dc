"""Changes of a state in velocity space, where a rotation has three numbers, and in positions, where it has four."""

import mujoco
import numpy as np
from jaxtyping import Float


def _turns(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Where quaternions are in qpos, and their angular velocities in qvel."""
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    skip = {free: 3, ball: 0}
    return [
        (int(q) + skip[int(kind)], int(v) + skip[int(kind)])
        for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True)
        if int(kind) in skip
    ]


def _position_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> Float[np.ndarray, "nq nv"]:
    """The derivative of the displaced positions in a displacement of velocity space."""
    basis = np.zeros((model.nq, model.nv))
    turns = _turns(model)
    turning = {q + i for q, _ in turns for i in range(4)}, {v + i for _, v in turns for i in range(3)}
    q_plain = [q for q in range(model.nq) if q not in turning[0]]
    v_plain = [v for v in range(model.nv) if v not in turning[1]]
    basis[q_plain, v_plain] = 1.0
    for q, v in turns:
        w, x, y, z = qpos[q : q + 4]
        basis[q : q + 4, v : v + 3] = 0.5 * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
    return basis


def state_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> np.ndarray:
    """Tangents [2 nv + na, nq + nv + na] of unit changes of positions (in velocity space), velocities, activations."""
    blocks = [_position_basis(model, qpos).T, np.eye(model.nv), np.eye(model.na)]
    rows, columns = [len(block) for block in blocks], [block.shape[1] for block in blocks]
    basis = np.zeros((sum(rows), sum(columns)))
    row = column = 0
    for block in blocks:
        basis[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return basis


def in_velocity_space(model: mujoco.MjModel, qpos: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes [K, nq + nv + na] in velocity space, [K, 2 nv + na]: of a unit quaternion, twice the part along it."""
    basis = _position_basis(model, qpos)
    inverse = basis / np.maximum((basis**2).sum(0), 1e-30)
    return np.concatenate([change[:, : model.nq] @ inverse, change[:, model.nq :]], axis=1)
