"""Motions to show: simulated by C MuJoCo under constant setpoints, or that of a problem."""

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines import objective, precision
from tog_mjx.problems import Problem
from tog_mjx.running.errors import InputError
from tog_mjx.running.quiet import without_warnings
from tog_mjx.running.types import Numbers
from tog_mjx.stepping.mjx_state import default_start, start_key

DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class Motion(NamedTuple):
    """Positions `qpos` [T, nq] of a model at `time` [T] (s), which starts at 0, and its controls, where known."""

    time: Float[np.ndarray, " T"]
    qpos: Float[np.ndarray, "T nq"]
    ctrl: Float[np.ndarray, "T nu"] | None = None

    def at(self, times: Float[np.ndarray, " n"]) -> "Motion":
        """What was recorded last up to the times (s); after the end, the end."""
        kept = np.searchsorted(self.time, times, side="right") - 1
        return Motion(times, self.qpos[kept], None if self.ctrl is None else self.ctrl[kept])


def start(model: mujoco.MjModel, setpoints: Float[np.ndarray, " nu"] | None = None) -> mujoco.MjData:
    """The state of `tog_mjx.stepping.mjx_state.default_start`.

    Its controls are the setpoints where given. The model's markers are moved to them, and its keyframe takes them, so
    that a viewer that loads the keyframe starts here again.

    Raises:
      InputError: for setpoints of the wrong number or not finite.
    """
    data = default_start(model)
    if setpoints is not None:
        if setpoints.shape != (model.nu,):
            raise InputError(f"{len(setpoints)} setpoints given; the scene takes {model.nu}, one of each actuator")
        if not (np.abs(setpoints) < mujoco.mjMAXVAL).all():  # MuJoCo ignores such controls.
            raise InputError(f"setpoints {setpoints.tolist()} are not finite or too large; give other numbers")
        data.ctrl[:] = setpoints
    move_markers(model, data.ctrl)
    if model.nkey:
        mujoco.mj_setKeyframe(model, data, start_key(model))
    mujoco.mj_forward(model, data)
    return data


def move_markers(model: mujoco.MjModel, controls: Float[np.ndarray, " nu"]) -> None:
    """Moves the markers to the pairs (x, z) of controls, in m."""
    for number, site in markers(model).items():
        x_and_z = controls[2 * number - 2 : 2 * number]
        if len(x_and_z) == 2:
            model.site_pos[site, [0, 2]] = x_and_z
            model.site_sameframe[site] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # Else a site at the origin stays.


def markers(model: mujoco.MjModel) -> dict[int, int]:
    """The sites `setpoint1`, `setpoint2`, ... of the world, by their numbers."""
    names = {site: model.site(site).name.removeprefix("setpoint") for site in np.flatnonzero(model.site_bodyid == 0)}
    return {int(name): int(site) for site, name in names.items() if name.isdecimal() and int(name) > 0}


def simulate(model: mujoco.MjModel, data: mujoco.MjData, duration: float) -> Motion:
    """The motion of C MuJoCo from `data`, under its controls, over `duration` (s) rounded to whole steps.

    Raises:
      InputError: where the simulation diverges.
    """
    data.time = 0
    qpos = [data.qpos.copy()]
    with without_warnings():
        for _ in range(round(duration / model.opt.timestep)):
            mujoco.mj_step(model, data)
            if any(data.warning[int(kind)].number for kind in DIVERGED):
                raise InputError(
                    f"the simulation diverges after {len(qpos) - 1} steps; "
                    "give other setpoints, or the scene a smaller <option timestep>"
                )
            qpos.append(data.qpos.copy())
    return Motion(np.arange(len(qpos)) * model.opt.timestep, np.array(qpos))


def motion_of(problem: Problem, x: Numbers, engine: str = "mjx") -> Motion:
    """That of a problem under its variables x [n].

    Raises:
      InputError: for an x of another shape, or a motion that does not stay finite.
    """
    with precision(engine):
        found = objective(problem, engine).motion(x)
    qpos = np.asarray(found.qpos)
    if not np.isfinite(qpos).all():
        step = int(np.isfinite(qpos).all(1).argmin())
        raise InputError(f"the motion is not finite from step {step} on; give other variables, or a smaller time step")
    return Motion(np.asarray(found.time) - float(found.time[0]), qpos, np.asarray(found.ctrl))


def read_numbers(path: Path) -> np.ndarray:
    """The array of a .npy file.

    Raises:
      InputError: for a file that cannot be read as one.
    """
    try:
        found = np.load(path, allow_pickle=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a .npy file") from None
    except ValueError as error:
        raise InputError(f"{path}: is no .npy file: {' '.join(str(error).split())}") from None
    if not isinstance(found, np.ndarray):
        raise InputError(f"{path}: holds several arrays; give a .npy file, of one")
    return found


def frame_times(duration: float, fps: float, speed: float) -> Float[np.ndarray, " n"]:
    """Times (s) of the frames of a motion shown at `speed` (1: as fast as it is). The last one is its end."""
    spacing = speed / fps
    count = int(np.ceil(duration / spacing - 1e-9)) + 1
    return np.minimum(np.arange(count) * spacing, duration)
