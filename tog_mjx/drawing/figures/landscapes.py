"""Figures 2 and 5: the cost over the window of setpoints, the initial guess, and the paths of both descents."""

from collections.abc import Mapping

import matplotlib.patheffects
import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import BEST, GUESS, METHOD, RC, new_figure
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape

FIGURE_NUMBER = {"flip": 2, "grasp": 5}
LEVELS = {"flip": np.linspace(0, 3.2, 17), "grasp": np.linspace(0, 1.5, 16)}
"""Of cost, the same for every simulator."""


def draw_landscape(task: Task, simulator: str, landscape: Landscape, descents: Mapping[str, Descent]) -> Figure:
    """Figure 2 (flip) or 5 (grasp) of the paper, and beyond it the paths of the descents (by method).

    The path is that of the first finger's setpoint, as far as it lies in the window.
    """
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(6.0, 4.6)
        axes = figure.subplots()
        filled = fill(axes, task, landscape, LEVELS[task.name])
        figure.colorbar(filled, ax=axes, label=rf"cost $J_\mathrm{{{task.name}}}$")
        for method, descent in descents.items():
            _draw_path(axes, method, descent)
        axes.plot(*task.initial_guess[:2], **GUESS)
        axes.set_xlim(*task.window[0])
        axes.set_ylim(*task.window[1])
        axes.set_title(f"Box {task.name} on {simulator}", loc="left")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def fill(axes: Axes, task: Task, landscape: Landscape, levels: Float[np.ndarray, " L"]) -> QuadContourSet:
    """The landscape as filled contours; yellow is high. What is not finite stays blank."""
    size = len(landscape.costs)
    x, z = (landscape.points[:, i].reshape(size, size) for i in (0, 1))
    costs = np.ma.masked_invalid(landscape.costs)
    filled = axes.contourf(x, z, costs, levels, cmap="cividis", extend="max")
    finger = "" if len(task.scene.fingers) == 1 else " of the left finger"
    axes.set_xlabel(f"setpoint x{finger} (m)")
    axes.set_ylabel(f"setpoint z{finger} (m)")
    return filled


def _draw_path(axes: Axes, method: str, descent: Descent) -> None:
    halo = [matplotlib.patheffects.withStroke(linewidth=3, foreground="white")]
    x, z = descent.setpoints[:, 0], descent.setpoints[:, 1]
    style = {**METHOD[method], "markersize": 4, "markevery": max(1, len(x) // 25)}
    axes.plot(x, z, **style, linewidth=1.2, path_effects=halo)
    best = descent.best_iteration
    axes.plot(x[best], z[best], **BEST, color=METHOD[method]["color"])
