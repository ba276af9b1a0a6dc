"""What a derivative is taken in: displacements x [n] of numbers of the start, of the inputs or of the model.

x = 0 is the start and the model as they are. Of positions, and of the orientations of mocap bodies, the displacement is
one of velocity space, as `mj_integratePos` adds it: a rotation has three numbers, not four.
"""

import functools
import math
from dataclasses import dataclass
from typing import TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tog_mjx.mjcf.fields import array_name, entries, entry_names, field_of
from tog_mjx.mjcf.followers import Origin
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.mjcf.parameter import ALONE, Parameter
from tog_mjx.mjcf.unused import unused
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.integration import positions_after, rotated
from tog_mjx.stepping.mjx_state import START

OF_DATA = ("ctrl", *START)
"""Variables of the start and the inputs; all others are of the model."""
TURNED = ("qpos", "mocap_quat")
"""Those that have more numbers than displacements."""
Model: TypeAlias = mjx.Model | MovedModel
"""Of the engine that moves the problem."""
Placed = tuple[Model, dict[str, Array]]
"""A model, and a start by the names of its fields in `mjx.Data`."""


@dataclass(frozen=True, eq=False)
class Displacements:
    """Numbers of one array.

    Args:
      wrt: "ctrl", "qpos", "qvel", "act", "mocap_pos", "mocap_quat", or a field of floats of `mjx.Model`, such as
        "geom_friction" or "opt.gravity"; or one number of it, as in "ctrl[0]" or "geom_friction[2, 0]". A field moves
        what follows from it, see `tog.Parameter`, unless "field:" stands before it.
      origin: what the model was compiled from, if known.
    """

    model: mujoco.MjModel
    wrt: str
    origin: Origin | None = None

    def __post_init__(self):
        require_kind("wrt", self.wrt, str, f"give {', '.join(OF_DATA)} or the name of a field of mjx.Model")
        if self.array not in OF_DATA:
            field_of(self.model, self.array, OF_DATA)
        elif self.wrt.startswith(ALONE):
            raise InputError(f"{self.wrt!r} is no field of mjx.Model; give {self.array}")
        if not len(self.chosen):
            raise InputError(f"the scene has no {self.wrt}: differentiate with respect to something else")

    @property
    def array(self) -> str:
        """The name of that array."""
        return array_name(self.wrt.removeprefix(ALONE))

    @functools.cached_property
    def parameter(self) -> Parameter | None:
        """The numbers of the model, where they are of it."""
        return None if self.array in OF_DATA else Parameter(self.model, self.wrt, self.origin)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of all numbers of the array."""
        model = self.model
        sizes = {"ctrl": (model.nu,), "qpos": (model.nv,), "qvel": (model.nv,), "act": (model.na,)}
        mocap = dict.fromkeys(("mocap_pos", "mocap_quat"), (model.nmocap, 3))
        return {**sizes, **mocap}.get(self.array) or field_of(model, self.array).shape

    @property
    def chosen(self) -> Int[np.ndarray, " n"]:
        """The variables among those numbers."""
        return entries(self.wrt.removeprefix(ALONE), self.shape)

    @property
    def mask(self) -> Bool[np.ndarray, "..."]:
        """Which of those numbers are variables."""
        chosen = np.zeros(math.prod(self.shape), bool)
        chosen[self.chosen] = True
        return chosen.reshape(self.shape)

    @property
    def scale(self) -> Float[np.ndarray, " n"]:
        """The size [n] of a displacement that is large: that of the number itself in the model, where it is not 0."""
        if self.parameter is None:
            return np.ones(len(self.chosen))
        values = np.abs(self.parameter.value)
        return np.where(values > 0, values, 1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Of x [n]."""
        if self.array == "ctrl":
            return control_names(self.model, self.chosen)
        return entry_names(self.array, self.shape, self.chosen)

    @property
    def kin(self) -> Int[np.ndarray, " n"]:
        """What each of x [n] acts on, by number: of positions and velocities the tree of bodies, of mocap bodies the
        body; each control and activation is meant to act by itself; of a field of the model some numbers may well do
        so, and others not."""
        match self.array:
            case "ctrl" | "act":
                return self.chosen
            case "qpos" | "qvel":
                return self.model.dof_treeid[self.chosen]
            case "mocap_pos" | "mocap_quat":
                return self.chosen // 3
        return np.zeros(len(self.chosen), int)

    @property
    def unused(self) -> Bool[np.ndarray, " n"]:
        """Which of x [n] are numbers of the model that nothing reads."""
        return np.broadcast_to(unused(self.model, self.array), self.shape).ravel()[self.chosen]

    def place(self, x: Float[Array, " n"], model: Model, start: dict[str, Array]) -> Placed:
        """The model and the start, displaced."""
        if self.parameter:
            return self.parameter.moved(model, x), start
        name, value = self.array, start[self.array]
        change = jnp.zeros(math.prod(self.shape), x.dtype).at[self.chosen].set(x).reshape(self.shape)
        match name:
            case "qpos":
                moved = positions_after(self.model, value, change)
            case "mocap_quat":
                moved = jax.vmap(rotated)(value, change)
            case _:
                moved = value + change
        return model, {**start, name: moved}


def control_names(model: mujoco.MjModel, chosen: Int[np.ndarray, " n"]) -> tuple[str, ...]:
    """The actuators' names, or "ctrl[2]" of one without."""
    return tuple(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) or f"ctrl[{i}]" for i in chosen)


def default_wrt(model: mujoco.MjModel) -> str:
    """The variables unless told otherwise: the controls, where there are any."""
    return "ctrl" if model.nu else "qvel"
