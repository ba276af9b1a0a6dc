"""Frames of a motion seen from the side, drawn with Matplotlib: no OpenGL needed."""

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.viewing.camera import window

_DPI = 100


def planar_frames(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, "n nq"], size: tuple[int, int]
) -> UInt8[np.ndarray, "n h w 3"]:
    """One frame of `size` (width, height) in pixels for each row of qpos. `data` is moved."""
    width, height = size
    x, z, tall = window(model)
    wide = tall * width / height
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    planar.frame(axes, (x - wide / 2, x + wide / 2), (z - tall / 2, z + tall / 2))
    axes.set_axis_off()
    frames = np.empty((len(qpos), height, width, 3), np.uint8)
    for i, position in enumerate(qpos):
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        patches = planar.draw(axes, [*planar.outlines(model, data), *planar.site_outlines(model, data)])
        canvas.draw()
        frames[i] = np.asarray(canvas.buffer_rgba())[:, :, :3]
        for patch in patches:
            patch.remove()
    return frames
