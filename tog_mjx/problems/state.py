"""What a cost and a policy see of a motion, the same on all engines."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.running.errors import InputError, near
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.complete import complete


class Derived:
    """What follows from a moment, as far as an engine knows it: here nothing, as it says."""

    def __init__(self, unknown: str):
        self._unknown = unknown

    def site(self, number: int) -> Float[Array, "3"]:
        del number
        raise InputError(self._unknown)

    def body(self, number: int) -> Float[Array, "3"]:
        del number
        raise InputError(self._unknown)

    def sensors(self, stage: int) -> Float[Array, " ns"]:
        """All sensordata, of which those may be missing that need a later `mujoco.mjtStage`."""
        del stage
        raise InputError(self._unknown)

    @property
    def qacc(self) -> Float[Array, " nv"]:
        raise InputError(self._unknown)

    @property
    def data(self) -> mjx.Data:
        raise InputError(self._unknown)


class OfMjx(Derived):
    """What MJX computes: poses, and all else where it moves the problem too."""

    def __init__(self, poses: Callable[[], mjx.Data], everything: Callable[[], mjx.Data]):
        self._place, self._complete = poses, everything

    def site(self, number: int) -> Float[Array, "3"]:
        return self._poses.site_xpos[number]

    def body(self, number: int) -> Float[Array, "3"]:
        return self._poses.xpos[number]

    def sensors(self, stage: int) -> Float[Array, " ns"]:
        del stage
        return self.data.sensordata

    @property
    def qacc(self) -> Float[Array, " nv"]:
        return self.data.qacc

    @functools.cached_property
    def data(self) -> mjx.Data:
        return self._complete()

    @functools.cached_property
    def _poses(self) -> mjx.Data:
        return self._place()


@dataclass(frozen=True, eq=False)
class State:
    """A moment of a motion. What is derived from it is computed where it is asked for, and else costs nothing.

    Attributes:
      time: s. qpos [nq], qvel [nv] and act [na]: as in `mjx.Data`.
      ctrl: the controls [nu] in force: for a policy, which gives the next ones, those of the moment before.

    Units: the model's, SI where it is: m and rad, m/s and rad/s; of a sensor, its own.
    Gradient: of all that it shows, as that of `tog.objective`, in the problem's variables.
    """

    time: Float[Array, ""]
    qpos: Float[Array, " nq"]
    qvel: Float[Array, " nv"]
    act: Float[Array, " na"]
    ctrl: Float[Array, " nu"]
    _names: mujoco.MjModel
    _derived: Derived

    @classmethod
    def of(cls, names: mujoco.MjModel, data: mjx.Data, poses: Callable, everything: Callable) -> "State":
        """That in `data`, of a model with those names; `poses` and `everything` give data with what follows from it."""
        return cls(data.time, data.qpos, data.qvel, data.act, data.ctrl, names, OfMjx(poses, everything))

    @classmethod
    def at(cls, names: mujoco.MjModel, model: mjx.Model, data: mjx.Data, differentiation: str) -> "State":
        """That in `data`; all else is computed from it, by MJX."""
        poses, everything = lambda: mjx.kinematics(model, data), lambda: complete(model, data, differentiation)
        return cls.of(names, data, poses, everything)

    @property
    def data(self) -> mjx.Data:
        """All of `mjx.Data` of this moment: poses, contacts, forces, accelerations, sensors.

        Raises:
          InputError: on an engine whose forces are not MJX's.
        """
        return self._derived.data

    @property
    def qacc(self) -> Float[Array, " nv"]:
        """The accelerations [nv] under the controls in force."""
        return self._derived.qacc

    @property
    def sensordata(self) -> Float[Array, " ns"]:
        """All sensors [ns], in the order of the model; `sensor` gives one by its name."""
        return self._derived.sensors(int(mujoco.mjtStage.mjSTAGE_ACC))

    def sensor(self, name: str) -> Float[Array, " k"]:
        """The numbers [k] of one sensor. InputError: for a name that the scene does not have."""
        i = self._number(mujoco.mjtObj.mjOBJ_SENSOR, "sensor", name)
        first = self._names.sensor_adr[i]
        return self._derived.sensors(int(self._names.sensor_needstage[i]))[first : first + self._names.sensor_dim[i]]

    def joint(self, name: str) -> Float[Array, "*k"]:
        """A joint's position: a number of a slide (m) or a hinge (rad), [4] of a ball, [7] of a free one.
        InputError: for a name that the scene does not have."""
        return self._of_joint(name, self.qpos, self._names.jnt_qposadr, (7, 4, 1, 1))

    def speed(self, name: str) -> Float[Array, "*k"]:
        """A joint's velocity: a number of a slide (m/s) or a hinge (rad/s), [3] of a ball, [6] of a free one.
        InputError: for a name that the scene does not have."""
        return self._of_joint(name, self.qvel, self._names.jnt_dofadr, (6, 3, 1, 1))

    def _of_joint(self, name: str, values: Array, addresses: np.ndarray, sizes: tuple[int, ...]) -> Array:
        i = self._number(mujoco.mjtObj.mjOBJ_JOINT, "joint", name)
        first, size = int(addresses[i]), sizes[self._names.jnt_type[i]]
        return values[first] if size == 1 else values[first : first + size]

    def site(self, name: str) -> Float[Array, "3"]:
        """Where a site is [3], in m. InputError: for a name that the scene does not have."""
        return self._derived.site(self._number(mujoco.mjtObj.mjOBJ_SITE, "site", name))

    def body(self, name: str) -> Float[Array, "3"]:
        """Where a body's frame is [3], in m. InputError: for a name that the scene does not have."""
        return self._derived.body(self._number(mujoco.mjtObj.mjOBJ_BODY, "body", name))

    def _number(self, kind: mujoco.mjtObj, what: str, name: str) -> int:
        found = mujoco.mj_name2id(self._names, kind, name)
        if found < 0:
            model = self._names
            count = {"sensor": model.nsensor, "site": model.nsite, "body": model.nbody, "joint": model.njnt}[what]
            names = [some for i in range(count) if (some := mujoco.mj_id2name(self._names, kind, i))]
            listed = f"choose from {', '.join(names[:20])}" if names else "none has a name"
            raise InputError(f"the scene has no {what} named {name}; {listed}{near(name, names)}")
        return found
