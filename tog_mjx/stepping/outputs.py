"""What is asked of the last state of a motion: numbers y [m] of it."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from tog_mjx.mjcf.fields import array_name, entries
from tog_mjx.running.errors import InputError, near, require_kind
from tog_mjx.running.user_code import call, real
from tog_mjx.stepping._mjx import constraint_rows, mjx
from tog_mjx.stepping.implicit import FORWARDS

Cost = Callable[[mjx.Data], Array]
_SIZES = {"qpos": "nq", "qvel": "nv", "acc": "nv"}


@dataclass(frozen=True, eq=False)
class Outputs:
    """Numbers of the last state, or of what follows from it and the last inputs.

    Args:
      output: "qpos", "qvel", "acc" (the accelerations), the name of a site, whose position counts, or of a sensor
        ("sensor:NAME" where a site has that name too); or one number of it; or a function of the last `mjx.Data`, as
        `complete` leaves it, that returns a number.
      differentiation: see `tog.step`.
    """

    model: mujoco.MjModel
    output: str | Cost
    differentiation: str

    def __post_init__(self):
        if not callable(self.output):
            told = "give qpos, qvel, acc, the name of a site or of a sensor, or a function"
            require_kind("output", self.output, str, told)
            entries(self.output, self._shape)

    @property
    def names(self) -> tuple[str, ...]:
        """Of y [m]."""
        if not isinstance(self.output, str):
            return (getattr(self.output, "__name__", "cost"),)
        name = array_name(self.output)
        every = [f"{name}[{i}]" for i in range(self._shape[0])]
        if self._source[0] == "site":
            every = [f"{name}.{axis}" for axis in "xyz"]
        return tuple(every[i] for i in entries(self.output, self._shape))

    @property
    def bodies(self) -> Int[np.ndarray, " m"]:
        """What each of y [m] is of, by number: of positions, velocities and accelerations the tree of bodies that are
        joined."""
        if not isinstance(self.output, str) or self._source[0] not in _SIZES:
            return np.zeros(len(self.names), int)
        trees = self.model.dof_treeid
        if self._source[0] == "qpos":
            sizes = np.diff([*self.model.jnt_qposadr, self.model.nq])
            trees = np.repeat(trees[self.model.jnt_dofadr], sizes)
        return trees[entries(self.output, trees.shape)]

    def observe(self, model: mjx.Model, data: mjx.Data) -> Float[Array, " m"]:
        """y of the state and the inputs in `data`; the rest of it is computed here.

        Raises:
          InputError: for a cost that fails, or whose value is no number.
        """
        if not isinstance(self.output, str):
            return _number(self.names[0], self.output, complete(model, data, self.differentiation))
        kind, i = self._source
        match kind:
            case "acc":
                every = complete(model, data, self.differentiation).qacc
            case "sensor":
                first = self.model.sensor_adr[i]
                every = complete(model, data, self.differentiation).sensordata[first : first + self._shape[0]]
            case "site":
                every = mjx.kinematics(model, data).site_xpos[i]
            case state:
                every = getattr(data, state)
        return every[entries(self.output, self._shape)]

    @property
    def _source(self) -> tuple[str, int]:
        """One of _SIZES, or "site" or "sensor" and its number."""
        name = array_name(str(self.output))
        return (name, 0) if name in _SIZES else _found(self.model, name)

    @property
    def _shape(self) -> tuple[int]:
        kind, i = self._source
        if kind in _SIZES:
            return (getattr(self.model, _SIZES[kind]),)
        return (3 if kind == "site" else int(self.model.sensor_dim[i]),)


def complete(model: mjx.Model, data: mjx.Data, differentiation: str) -> mjx.Data:
    """`data` with all that MJX computes of its state and inputs: poses, forces, accelerations, sensors, and the bodies'
    forces and momenta. Under jit what is not read of it costs nothing."""
    return completed(model, FORWARDS[differentiation](model, data))


def completed(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """As `complete`, of data on which `forward` has been called."""
    if constraint_rows(data).jacobian.size == 0:
        data = mjx.sensor_acc(model, data)  # Which MJX leaves out where nothing can touch.
    return mjx.subtree_vel(model, mjx.rne_postconstraint(model, data))


def _number(name: str, cost: Cost, data: mjx.Data) -> Float[Array, "1"]:
    number = real(f"the cost {name}", call(f"the cost {name} fails", cost, data), "one number")
    if number.size != 1:
        raise InputError(f"the cost {name} returns an array of shape {list(number.shape)}; give one number")
    return jnp.reshape(number, (1,)).astype(float)


def _found(model: mujoco.MjModel, name: str) -> tuple[str, int]:
    """A site or a sensor of that name.

    Raises:
      InputError: with the names that there are.
    """
    kinds = {"site": mujoco.mjtObj.mjOBJ_SITE, "sensor": mujoco.mjtObj.mjOBJ_SENSOR}
    for kind, number in kinds.items():
        if (i := mujoco.mj_name2id(model, number, name)) >= 0:
            return kind, i
    only = name.removeprefix("sensor:")
    if only != name and (i := mujoco.mj_name2id(model, kinds["sensor"], only)) >= 0:
        return "sensor", i
    sites, sensors = (
        [some for i in range(count) if (some := getattr(model, kind)(i).name)]
        for kind, count in (("site", model.nsite), ("sensor", model.nsensor))
    )
    listed = f"; its sites: {', '.join(sites[:20])}" if sites else ""
    listed += f"; its sensors: {', '.join(sensors[:20])}" if sensors else ""
    close = near(name, [*_SIZES, *sites, *sensors])
    raise InputError(f"the scene has no site or sensor named {name}{listed}; or give qpos, qvel or acc{close}")
