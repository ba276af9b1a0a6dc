"""Changes of a state in velocity space, where a rotation has three numbers, and in positions, where it has four."""

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag


def _position_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> Float[np.ndarray, "nq nv"]:
    """The derivative of the displaced positions in a displacement of velocity space."""
    basis = np.zeros((model.nq, model.nv))
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
        if kind == free:
            basis[q : q + 3, v : v + 3] = np.eye(3)
            q, v = q + 3, v + 3
        if kind in (free, ball):
            w, x, y, z = qpos[q : q + 4]
            basis[q : q + 4, v : v + 3] = 0.5 * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
        else:
            basis[q, v] = 1.0
    return basis


def state_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> np.ndarray:
    """Tangents [2 nv + na, nq + nv + na] of unit changes of positions (in velocity space), velocities, activations."""
    return block_diag(_position_basis(model, qpos).T, np.eye(model.nv), np.eye(model.na))


def in_velocity_space(model: mujoco.MjModel, qpos: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes [K, nq + nv + na] in velocity space, [K, 2 nv + na]: of a unit quaternion, twice the part along it."""
    basis = _position_basis(model, qpos)
    inverse = basis / np.maximum((basis**2).sum(0), 1e-30)
    return np.concatenate([change[:, : model.nq] @ inverse, change[:, model.nq :]], axis=1)
