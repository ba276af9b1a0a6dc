"""What a state is and what inputs are, by their names in MuJoCo's data, and where a scene starts.

A time step is a function of both: it passes the state on to the next one, and leaves the inputs as they are.
"""

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.types import AnyArray
from tog_mjx.stepping._mjx import make_data, mjx
from tog_mjx.stepping.randomised import require_one

MOVING = ("qpos", "qvel", "act")
"""The part of the state that has derivatives."""
STATE = ("time", *MOVING, "qacc_warmstart")
"""What a time step passes on. The warm start [nv] is where the solver starts, never where it ends."""
MOCAP = ("mocap_pos", "mocap_quat")
INPUTS = ("ctrl", "qfrc_applied", "xfrc_applied", *MOCAP, "eq_active")
"""What it is given."""
START = (*MOVING, *MOCAP)
"""What a motion may be started with, beside its controls."""


def state_of(data: mjx.Data) -> dict[str, Array]:
    """The state, by STATE: what a loop over time steps carries. `data.replace(**state)` puts it back."""
    return {name: getattr(data, name) for name in STATE}


def require_state(model: mujoco.MjModel | mjx.Model, data: Any) -> None:
    """Raises InputError for data that are of another model, as their sizes tell, and for a batch of models."""
    if isinstance(model, mjx.Model):
        require_one(model)
    nq, nv, bodies = model.nq, model.nv, model.nbody
    sizes = {"qpos": (nq,), "qvel": (nv,), "act": (model.na,), "ctrl": (model.nu,), "xfrc_applied": (bodies, 6)}
    for name, shape in {**sizes, "mocap_pos": (model.nmocap, 3), "eq_active": (model.neq,)}.items():
        if (found := getattr(data, name).shape) != shape:
            told = f"{name} of the data has the shape {list(found)}, and that of the model {list(shape)}"
            raise InputError(f"{told}; give data of this model, and a batch of them through jax.vmap")


def require_on_mjx(model: object, data: object) -> None:
    """Raises InputError for what is no model and data of MJX's, or not of each other."""
    require_kind("the model", model, mjx.Model, "give what mjx.put_model makes of a mujoco.MjModel")
    require_kind("the data", data, mjx.Data, "give what mjx.make_data or mjx.put_data makes")


def on_mjx(model: mjx.Model, data: mujoco.MjData) -> mjx.Data:
    """New data on MJX with the state and the inputs of C MuJoCo's."""
    new = make_data(model)
    # Copies: on a CPU JAX may share the memory of an array, which MuJoCo writes to.
    given = {name: np.array(getattr(data, name)) for name in (*STATE, *INPUTS)}
    return new.replace(**{name: jnp.asarray(value, getattr(new, name).dtype) for name, value in given.items()})


def copy_of(model: mujoco.MjModel, data: mujoco.MjData, **state: AnyArray | float) -> mujoco.MjData:
    """New data of C MuJoCo with the state and the inputs of others; `state` replaces some of them."""
    new = mujoco.MjData(model)
    for name in (*STATE, *INPUTS):
        setattr(new, name, state.get(name, getattr(data, name)))
    return new


def start_key(model: mujoco.MjModel) -> int:
    """The number of the keyframe from which a scene starts: the one named `start`, else the first; -1 without any."""
    return max(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "start"), min(model.nkey, 1) - 1)


def default_start(model: mujoco.MjModel) -> mujoco.MjData:
    """New data where a scene starts unless told otherwise: at its keyframe `start`, else at its first keyframe, else at
    its initial pose, at rest."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, start_key(model))
    return data
