"""Changes of a state in velocity space, where a rotation has three numbers, and in positions, where it has four."""

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.stepping.velocity_space import position_basis, velocity_basis


def state_basis(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> np.ndarray:
    """Tangents [2 nv + na, nq + nv + na] of unit changes of positions (in velocity space), velocities, activations."""
    nq, nv, na = model.nq, model.nv, model.na
    found = np.eye(2 * nv + na, nq + nv + na, nq - nv)
    found[:nv, :nq] = position_basis(model, qpos).T
    return found


def in_velocity_space(model: mujoco.MjModel, qpos: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes [K, nq + nv + na] in velocity space, [K, 2 nv + na]."""
    into = velocity_basis(model, qpos)
    return np.concatenate([change[:, : model.nq] @ into.T, change[:, model.nq :]], axis=1)
