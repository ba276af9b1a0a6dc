"""Frames of a motion: rendered by MuJoCo where OpenGL is there, else drawn from the side without it."""

import os
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import UInt8

from tog_mjx.drawing.viewing.camera import Views, aim, plane_camera
from tog_mjx.drawing.viewing.child import run_python
from tog_mjx.drawing.viewing.looks import Scenery, dress
from tog_mjx.drawing.viewing.planar_frames import planar_frames
from tog_mjx.drawing.viewing.shown import Motion
from tog_mjx.drawing.viewing.strip import strip_height, strips
from tog_mjx.running.errors import InputError

_OFF = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL with which MuJoCo renders nothing."""
_MAX_BYTES = 2**30


class Frames(NamedTuple):
    """Images [n, height, width, 3] of red, green and blue, and one line that says how they were made."""

    images: UInt8[np.ndarray, "n h w 3"]
    method: str


def render(model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, size: tuple[int, int]) -> Frames:
    """One frame of `size` (width, height) in pixels for each moment of a motion. `data` has mocap poses, and is moved.

    The camera is the one called `plane`, where the model has it, else the free one, which follows what moves; see
    `camera.aim`. What a file leaves without light, colour or size is given some, see `looks.dress`. Controls that
    change are drawn below. The environment variable MUJOCO_GL chooses the OpenGL backend; without it EGL and OSMesa are
    tried, in this order.

    Raises:
      InputError: for more frames than fit in memory.
    """
    if len(motion.qpos) * size[0] * size[1] * 3 > _MAX_BYTES:
        raise InputError(
            f"{len(motion.qpos)} frames of {size[0]} x {size[1]} pixels are too many; give a lower --fps, a smaller "
            "--size, a shorter --duration or a higher --speed"
        )
    if low := strip_height(motion, size[1]):
        above = _pictures(model, data, motion, (size[0], size[1] - low))
        below = strips(model, motion, (size[0], low))
        return Frames(np.concatenate([above.images, below], axis=1), f"{above.method}; below, the controls over time")
    return _pictures(model, data, motion, size)


def _pictures(model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, size: tuple[int, int]) -> Frames:
    views = aim(model, data, motion.qpos, size[0] / size[1])
    scenery = dress(model, data, views.height(model))
    reasons = []
    for backend in _backends():
        images = _gl_frames(backend, model, data, motion.qpos, size, views, scenery)
        if not isinstance(images, str):
            return Frames(images, f"rendered by MuJoCo with OpenGL ({backend or 'default'})")
        reasons.append(f"{backend or 'default'}: {images}")
    why = "; ".join(reasons) or f"MUJOCO_GL={os.environ['MUJOCO_GL']}"
    images = planar_frames(model, data, motion.qpos, views.windows, size, scenery)
    return Frames(images, f"drawn from the side without OpenGL ({why})")


def _backends() -> tuple[str, ...]:
    wish = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wish:
        return () if wish in _OFF else (wish,)
    return ("egl", "osmesa") if sys.platform == "linux" else ("",)


def _gl_frames(
    backend: str,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    size: tuple[int, int],
    views: Views,
    scenery: Scenery,
) -> np.ndarray | str:
    """The frames, or one line that says why this backend makes none."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"), None)
        shown: dict[str, Any] = {"qpos": qpos, "mocap_pos": data.mocap_pos, "mocap_quat": data.mocap_quat, "size": size}
        seen: dict[str, Any] = {
            "camera": plane_camera(model),
            "lookat": views.lookat,
            "from": views[1:4],
        } | scenery._asdict()
        np.savez(folder / "states.npz", **shown, **seen)
        # PyOpenGL's own choice, which MuJoCo makes in this process, would bind the other one to the same backend.
        environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
        program = str(Path(__file__).with_name("gl_frames.py"))
        complaint = run_python("-P", program, name, environment=environment | {"MUJOCO_GL": backend})
        return complaint or np.load(folder / "frames.npy")
