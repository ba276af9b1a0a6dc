"""The outputs of a scene function on C MuJoCo, and their derivative, in NumPy."""

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.moment import QACC, Dynamics, Numbers, Place
from tog_mjx.problems.outputs import Outputs
from tog_mjx.stepping.velocity_space import velocity_basis


class Seen:
    """Of states [., s] and the controls in force, see `engines.c_mujoco.forward`."""

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

    def values(self, states: Float[np.ndarray, "N s"], controls: Float[np.ndarray, "N nu"]) -> np.ndarray:
        """y, [N, m]."""
        every = (
            states[:, 1:] if self._numbers is None else self._numbers.values(states, controls, self._held(len(states)))
        )
        return every[:, self._which]

    def slopes(
        self,
        state: Float[np.ndarray, " s"],
        controls: Float[np.ndarray, " nu"],
        moved: Float[np.ndarray, "n K"],
        steered: Float[np.ndarray, "nu K"],
    ) -> np.ndarray:
        """What y changes by, [m, K], as (qpos, qvel, act) are `moved` and controls `steered`."""
        if self._numbers is None:
            return moved[self._which]
        q = self._forward.ends[1]
        turned = velocity_basis(self._forward.model, state[1:q]) @ moved[: q - 1]
        change = np.concatenate([turned, moved[q - 1 :], steered])
        return self._numbers.slopes(state[None], controls[None], self._held(1))[0, self._which] @ change

    def _held(self, count: int) -> np.ndarray:
        return np.tile(self._forward.row, (count, 1))
