"""The outputs of a scene function on C MuJoCo, and their derivative, in NumPy."""

import mujoco
import numpy as np

from tog_mjx.checks.measured.placed import Given
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.moment import QACC, Dynamics, Numbers, Place
from tog_mjx.problems.outputs import Outputs
from tog_mjx.stepping.velocity_space import velocity_basis


class Seen:
    """Of the last states of motions, the controls in force and what is held."""

    def __init__(self, y: Outputs, forward: Forward):
        model, (kind, name) = forward.model, y.source
        self._forward, self._which = forward, y.chosen
        numbers: Numbers | None = None
        match kind:
            case "acc":
                numbers = Dynamics(forward, QACC)
            case "site":
                numbers = Place(forward, mujoco.mjtObj.mjOBJ_SITE, model.site(name).id)
            case "sensor":
                i = model.sensor(name).id
                numbers = Dynamics(forward, int(model.sensor_needstage[i]))
                self._which = self._which + model.sensor_adr[i]
            case _:
                self._which = self._which + (0 if kind == "qpos" else model.nq)
        self._numbers = numbers

    def values(self, given: Given) -> np.ndarray:
        """y, [N, m]."""
        every = given.states[:, 1:] if self._numbers is None else self._numbers.values(*given)
        return every[:, self._which]

    def slopes(self, end: Given, moved: Given, is_held: bool) -> np.ndarray:
        """What y changes by at an end [1, ...], [m, K], as (qpos, qvel, act), controls and, with `is_held`, what is
        held are moved."""
        if self._numbers is None:
            return moved.states[self._which]
        q = self._forward.ends[1]
        turned = velocity_basis(self._forward.model, end.states[0, 1:q]) @ moved.states[: q - 1]
        change = np.concatenate([turned, moved.states[q - 1 :], moved.controls])
        precise = self._numbers.precise
        found = precise.slopes(*end)[0, self._which] @ change
        if is_held:
            found = found + precise.in_held(*end)[0, self._which] @ moved.held
        return found
