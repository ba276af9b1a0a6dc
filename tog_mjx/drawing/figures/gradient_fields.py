"""Two codes, one landscape: costs and gradient fields side by side, and the angle between the gradients."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.landscapes import NAMES, Arrows, Surface, draw_downhill, fill
from tog_mjx.drawing.figures.style import GUESS, RC, new_figure


def draw_agreement(
    fields: Mapping[str, tuple[Surface, Arrows]],
    degrees: Float[np.ndarray, " N"],
    guess: Float[np.ndarray, " 2"],
    *,
    cost: str = "cost $J$",
    names: tuple[str, str] = NAMES,
) -> Figure:
    """Two landscapes with their gradients, of one scale, and how far the gradients differ in direction.

    Args:
      fields: by code, two of them.
      degrees: angles between the two gradients at random points, positive.
    """
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(10.5, 3.6)
        *panels, last = figure.subplots(1, 3)
        low, high = np.percentile([costs for (_, costs), _ in fields.values()], (0, 98))
        levels = np.linspace(low, high, 15)
        for axes, (code, (surface, arrows)) in zip(panels, fields.items(), strict=True):
            filled = fill(axes, surface, levels, names)
            draw_downhill(axes, *arrows)
            axes.plot(*guess, **GUESS)
            axes.set_title(code, loc="left")
        figure.colorbar(filled, ax=panels, label=cost, shrink=0.85, format="%.2f")
        _draw_angles(last, degrees, tuple(fields))
    return figure


def _draw_angles(axes: Axes, degrees: Float[np.ndarray, " N"], names: tuple[str, ...]) -> None:
    """On a logarithmic axis, as agreement is a matter of orders of magnitude."""
    floor = 1e-6
    axes.hist(np.maximum(degrees, floor), bins=list(np.geomspace(floor, 180, 26)), color="#4c78a8", edgecolor="white")
    axes.set_xscale("log")
    axes.set_xlabel("angle (degrees)")
    axes.set_ylabel("random setpoints")
    axes.set_title(f"gradients of {names[0]} and {names[1]}", loc="left")
