"""Frames of a motion seen from the side, drawn with Matplotlib: no OpenGL needed."""

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.viewing.looks import Scenery
from tog_mjx.drawing.viewing.targets import COLOR

_DPI = 100


def planar_frames(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: Float[np.ndarray, "n nq"],
    windows: Float[np.ndarray, "n 3"],
    size: tuple[int, int],
    scenery: Scenery,
) -> UInt8[np.ndarray, "n h w 3"]:
    """One frame of `size` (width, height) in pixels for each row of qpos, each in its Window. `data` is moved."""
    width, height = size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    floors = [*scenery.floors, *planar.textured_planes(model)]
    frames = np.empty((len(qpos), height, width, 3), np.uint8)
    for i, (position, (x, z, tall)) in enumerate(zip(qpos, windows, strict=True)):
        half = tall * width / height / 2
        planar.frame(axes, (x - half, x + half), (z - tall / 2, z + tall / 2))
        axes.set_axis_off()
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        geoms, sites = planar.outlines(model, data), planar.site_outlines(model, data)
        ground = [shape for shape in geoms if not shape.moves]
        tiles = planar.tiles(model, data, floors, (x - half, x + half), scenery.tile)
        above = [*(shape for shape in geoms if shape.moves), *sites]
        patches = [*planar.draw(axes, ground), *planar.draw(axes, tiles, has_edge=False), *planar.draw(axes, above)]
        patches += planar.draw(axes, planar.balls(scenery.marks, scenery.radius, COLOR))
        canvas.draw()
        frames[i] = np.asarray(canvas.buffer_rgba())[:, :, :3]
        for patch in patches:
            patch.remove()
    return frames
