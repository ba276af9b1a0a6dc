"""What a viewer shows as time goes by: a live simulation, or a motion in a loop. Both are advanced by wall time."""

import copy

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.viewing.camera import Views, aim
from tog_mjx.drawing.viewing.looks import Scenery, dress
from tog_mjx.drawing.viewing.shown import DIVERGED, Motion, move_markers
from tog_mjx.running.quiet import without_warnings

HOLD = 1.0
"""Seconds for which the start of a simulation and the end of a motion stay, to be seen."""
_ASPECT = 1.5
"""About the width of a viewer over its height."""
_MAX_LAG = 0.1
"""Seconds of simulation that are made up for at most: where a computer is too slow, the simulation is slow too."""

_BRIGHTER = 0.3
"""Of the light at a viewer's camera."""
_PREVIEW, _MOMENTS = 1.0, 25
"""Seconds, and moments of them, for which the view of a live simulation is chosen."""
_STRAY = 0.3
"""How far bodies may go from the middle before they are followed, in distances of the camera."""
_VIEWS = 200
"""Moments for which the view of a motion is chosen at most."""


class Live:
    """C MuJoCo, simulating under the controls in `data`, which a viewer's sliders may change.

    A free camera begins with the view of what is about to happen. From there it should move with `lookat` [3] (m): what
    strays from the middle is followed.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float = 1.0):
        self.model, self.data = model, data
        self._speed = speed
        self._owed = -HOLD * speed
        views = aim(model, copy.copy(data), _preview(model, data), _ASPECT)
        self.scenery = _dress(model, data, views)
        self.lookat, self._leeway = views.lookat[0], _STRAY * views.distance
        self._moving = np.flatnonzero(model.body_weldid)
        self._ahead = self.lookat - self._middle()

    def _middle(self) -> Float[np.ndarray, " 3"]:
        return self.data.xipos[self._moving].mean(axis=0) if self._moving.size else np.zeros(3)

    def advance(self, seconds: float) -> None:
        self._owed += min(seconds, _MAX_LAG) * self._speed
        while self._owed >= self.model.opt.timestep:
            mujoco.mj_step(self.model, self.data)
            self._owed -= self.model.opt.timestep
        move_markers(self.model, self.data.ctrl)
        away = self._middle() + self._ahead - self.lookat
        reach = max(float(np.linalg.norm(away)), 1e-12)
        self.lookat = self.lookat + away * max(0.0, 1 - self._leeway / reach)


class Loop:
    """A motion, its end held for `HOLD`, again and again. `data` is written, not simulated.

    A free camera should move with `lookat` [3] (m).
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, speed: float = 1.0):
        self.model, self.data = model, data
        self._motion, self._speed = motion, speed
        self._clock = 0.0
        self._times = np.linspace(0, motion.time[-1], min(len(motion.time), _VIEWS))
        self._views = aim(model, data, motion.at(self._times).qpos, _ASPECT)
        self.scenery = _dress(model, data, self._views)
        self.advance(0.0)

    def advance(self, seconds: float) -> None:
        end = float(self._motion.time[-1])
        self._clock = (self._clock + seconds * self._speed) % (end + HOLD * self._speed)
        self.data.time = min(self._clock, end)
        self.data.qpos[:] = self._motion.at(np.array([self._clock])).qpos[0]
        self.data.qvel[:] = 0
        mujoco.mj_forward(self.model, self.data)
        self.lookat = np.array([np.interp(self._clock, self._times, axis) for axis in self._views.lookat.T])


def _dress(model: mujoco.MjModel, data: mujoco.MjData, views: Views) -> Scenery:
    """As `dress`. A viewer has no place for another light, so the one at its camera is brighter."""
    scenery = dress(model, data, views.height(model))
    if scenery.is_dark:
        model.vis.headlight.diffuse[:] += _BRIGHTER
    return scenery


def _preview(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "n nq"]:
    """Positions of the next second, as far as it does not diverge."""
    ahead, found = copy.copy(data), [data.qpos.copy()]
    steps = max(1, round(_PREVIEW / _MOMENTS / model.opt.timestep))
    with without_warnings():
        for _ in range(_MOMENTS):
            mujoco.mj_step(model, ahead, steps)
            if any(ahead.warning[int(kind)].number for kind in DIVERGED):
                break
            found.append(ahead.qpos.copy())
    return np.array(found)


Playback = Live | Loop
