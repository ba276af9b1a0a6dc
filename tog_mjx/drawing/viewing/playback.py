"""What a viewer shows as time goes by: a live simulation, or a motion in a loop. Both are advanced by wall time."""

import mujoco
import numpy as np

from tog_mjx.drawing.viewing.camera import aim, light
from tog_mjx.drawing.viewing.shown import Motion, move_markers

HOLD = 1.0
"""Seconds for which the start of a simulation and the end of a motion stay, to be seen."""
_ASPECT = 1.5
"""About the width of a viewer over its height."""
_MAX_LAG = 0.1
"""Seconds of simulation that are made up for at most: where a computer is too slow, the simulation is slow too."""


class Live:
    """C MuJoCo, simulating under the controls in `data`, which a viewer's sliders may change."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float = 1.0):
        self.model, self.data = model, data
        self._speed = speed
        self._owed = -HOLD * speed
        light(model)

    def advance(self, seconds: float) -> None:
        self._owed += min(seconds, _MAX_LAG) * self._speed
        while self._owed >= self.model.opt.timestep:
            mujoco.mj_step(self.model, self.data)
            self._owed -= self.model.opt.timestep
        move_markers(self.model, self.data.ctrl)


class Loop:
    """A motion, its end held for `HOLD`, again and again. `data` is written, not simulated."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, speed: float = 1.0):
        self.model, self.data = model, data
        self._motion, self._speed = motion, speed
        self._clock = 0.0
        light(model)
        aim(model, data, motion.qpos, _ASPECT)
        self.advance(0.0)

    def advance(self, seconds: float) -> None:
        end = float(self._motion.time[-1])
        self._clock = (self._clock + seconds * self._speed) % (end + HOLD * self._speed)
        self.data.time = min(self._clock, end)
        self.data.qpos[:] = self._motion.at(np.array([self._clock]))[0]
        self.data.qvel[:] = 0
        mujoco.mj_forward(self.model, self.data)


Playback = Live | Loop
