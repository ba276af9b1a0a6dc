"""Figure 1: the two tasks, from their start to their goal."""

from collections.abc import Sequence

import mujoco
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.figures.style import GUESS, RC, new_figure
from tog_mjx.paper.replay import positions
from tog_mjx.paper.tasks import Task

GOAL = {"linestyle": (0, (4, 2)), "edgecolor": "#333333", "linewidth": 1.2}


def draw_setups(tasks: Sequence[Task]) -> Figure:
    """Box and fingers at the start, the goal of the box as a dashed outline, the initial guess of the setpoints."""
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(8.4, 3.6)
        for axes, task in zip(figure.subplots(1, len(tasks), squeeze=False)[0], tasks, strict=True):
            _draw_setup(axes, task)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def _draw_setup(axes: Axes, task: Task) -> None:
    scene, data = task.scene, mujoco.MjData(task.scene.model)
    box, fingers = scene.start
    planar.draw(axes, planar.place(scene.model, data, positions(scene, box, fingers)))
    goal = planar.place(scene.model, data, positions(scene, np.array([*task.goal, 0, 0, 0]), fingers))
    for patch in planar.draw(axes, [shape for shape in goal if shape.name == "box"]):
        patch.set(facecolor="none", **GOAL)
        patch.set_label("goal of the box")
    axes.plot(*np.reshape(task.initial_guess, (-1, 2)).T, **{**GUESS, "label": "setpoints, initial guess"})
    planar.frame(axes, *_window(task))
    axes.set_title(f"Box {task.name}", loc="left")


def _window(task: Task) -> tuple[tuple[float, float], tuple[float, float]]:
    """Around the start and the goal."""
    box, fingers = task.scene.start
    x = np.concatenate([[box[0], task.goal[0]], fingers[:, 0]])
    return (x.min() - 0.45, x.max() + 0.45), (-0.08, max(task.goal[1], box[1]) + 0.45)
