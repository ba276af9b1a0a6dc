"""Two codes, one landscape: costs and gradient fields side by side, and the angle between the gradients."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.landscapes import fill
from tog_mjx.drawing.figures.style import GUESS, RC, new_figure
from tog_mjx.paper.tasks import Task
from tog_mjx.studies.landscape import GradientField, Landscape


def draw_agreement(
    task: Task, fields: Mapping[str, tuple[Landscape, GradientField]], degrees: Float[np.ndarray, " N"]
) -> Figure:
    """A figure of one task.

    Args:
      fields: by simulator, two of them.
      degrees: angles between the two gradients at random setpoints, positive.
    """
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(10.5, 3.6)
        *panels, last = figure.subplots(1, 3)
        low, high = np.percentile([landscape.costs for landscape, _ in fields.values()], (0, 98))
        levels = np.linspace(low, high, 15)
        for axes, (simulator, (landscape, field)) in zip(panels, fields.items(), strict=True):
            filled = fill(axes, task, landscape, levels)
            _draw_downhill(axes, field)
            axes.plot(*task.initial_guess[:2], **GUESS)
            axes.set_title(simulator, loc="left")
        figure.colorbar(filled, ax=panels, label=rf"cost $J_\mathrm{{{task.name}}}$", shrink=0.85, format="%.2f")
        _draw_angles(last, degrees, tuple(fields))
    return figure


def _draw_downhill(axes: Axes, field: GradientField) -> None:
    """Arrows of one length, none where the gradient is zero."""
    norm = np.linalg.norm(field.gradients, axis=1)
    moving = norm > 1e-9
    downhill = -field.gradients[moving] / norm[moving, None]
    axes.quiver(
        *field.points[moving].T,
        *downhill.T,
        color="white",
        edgecolor="black",
        linewidth=0.3,
        pivot="mid",
        width=0.007,
    )


def _draw_angles(axes: Axes, degrees: Float[np.ndarray, " N"], names: tuple[str, ...]) -> None:
    """On a logarithmic axis, as agreement is a matter of orders of magnitude."""
    floor = 1e-6
    axes.hist(np.maximum(degrees, floor), bins=list(np.geomspace(floor, 180, 26)), color="#4c78a8", edgecolor="white")
    axes.set_xscale("log")
    axes.set_xlabel("angle (degrees)")
    axes.set_ylabel("random setpoints")
    axes.set_title(f"gradients of {names[0]} and {names[1]}", loc="left")
