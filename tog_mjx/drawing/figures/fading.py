"""Figures 4 and 7: motions as fading boxes, under the initial guess and the best setpoints of either method."""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.figures.style import GUESS, RC, new_figure
from tog_mjx.paper.tasks import Task

FIGURE_NUMBER = {"flip": 4, "grasp": 7}
SNAPSHOTS = 7
_TRACK = "#a63d00"


class Motion(NamedTuple):
    """States of one motion, box [k, 6] and fingers [k, F, 4], and what made and judges it: setpoints [2F] and J."""

    box: np.ndarray
    fingers: np.ndarray
    setpoints: np.ndarray
    cost: float


def draw_motions(task: Task, simulator: str, motions: Mapping[str, Motion]) -> Figure:
    """Figure 4 (flip) or 7 (grasp) of the paper; `motions` by title, a panel each."""
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(3.5 * len(motions), 3.9)
        panels = figure.subplots(1, len(motions), squeeze=False, sharex=True, sharey=True)[0]
        window = _window(task, motions)
        for axes, (title, motion) in zip(panels, motions.items(), strict=True):
            _draw_motion(axes, task, motion)
            planar.frame(axes, *window)
            axes.label_outer()
            axes.set_title(f"{title}: J = {motion.cost:.4f}", loc="left", fontsize=9)
        figure.legend(
            *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8
        )
        figure.suptitle(f"Box {task.name} on {simulator}", x=0.01, ha="left")
    return figure


def _draw_motion(axes: Axes, task: Task, motion: Motion) -> None:
    data = mujoco.MjData(task.scene.model)
    planar.draw(axes, [shape for shape in planar.place(task.scene, data, *task.scene.start) if not shape.moves])
    moments = np.linspace(0, len(motion.box) - 1, SNAPSHOTS).round().astype(int)
    for moment, alpha in zip(moments, np.linspace(0.12, 1, SNAPSHOTS) ** 1.5, strict=True):
        shapes = planar.place(task.scene, data, motion.box[moment], motion.fingers[moment])
        planar.draw(axes, [shape for shape in shapes if shape.moves], alpha)
    for finger, track in enumerate(np.moveaxis(motion.fingers, 1, 0)):
        axes.plot(*track[:, :2].T, color=_TRACK, linewidth=1.2, label="_" if finger else "path of a finger")
    setpoints = np.reshape(motion.setpoints, (-1, 2))
    axes.plot(*setpoints.T, **{**GUESS, "marker": "P", "color": "#1b1b1b", "label": "setpoint"})


def _window(task: Task, motions: Mapping[str, Motion]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Around all that is drawn, the same for every panel."""
    margin = 0.12 + np.linalg.norm(task.scene.physics.box_half)
    boxes = np.concatenate([motion.box[:, :2] for motion in motions.values()])
    points = np.concatenate(
        [motion.fingers[..., :2].reshape(-1, 2) for motion in motions.values()]
        + [np.reshape(motion.setpoints, (-1, 2)) for motion in motions.values()]
    )
    low = np.minimum(boxes.min(0) - margin, points.min(0) - 0.12)
    high = np.maximum(boxes.max(0) + margin, points.max(0) + 0.12)
    return (low[0], high[0]), (-0.12, high[1])
