"""The cost over two variables, the initial guess, and the paths of descents."""

from collections.abc import Mapping

import matplotlib.patheffects
import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import BEST, GUESS, RC, look, new_figure

Surface = tuple[Float[np.ndarray, "_ 2"], Float[np.ndarray, "_ _"]]
"""Points [n * n, 2] of a grid, along the first variable first, and the costs there [n, n], as a `Landscape` has."""
Path = tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, " _"]]
"""Iterates [k, m], of which the first two variables are drawn, and their costs [k]."""
Arrows = tuple[Float[np.ndarray, "_ 2"], Float[np.ndarray, "_ 2"]]
"""Points [N, 2] and the gradients there [N, 2], as a `GradientField` has."""
NAMES = ("first variable", "second variable")


def draw_landscape(
    surface: Surface,
    levels: Float[np.ndarray, " L"],
    paths: Mapping[str, Path],
    guess: Float[np.ndarray, " 2"],
    *,
    title: str = "",
    cost: str = "cost $J$",
    names: tuple[str, str] = NAMES,
    arrows: Arrows | None = None,
) -> Figure:
    """Filled contours at these levels of cost, and the paths (by method) as far as they lie in the grid; arrows point
    downhill."""
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(6.0, 4.6)
        axes = figure.subplots()
        figure.colorbar(fill(axes, surface, levels, names), ax=axes, label=cost)
        if arrows:
            draw_downhill(axes, *arrows)
        for method, path in paths.items():
            _draw_path(axes, method, *path)
        axes.plot(*guess, **GUESS)
        (x_min, z_min), (x_max, z_max) = surface[0].min(axis=0), surface[0].max(axis=0)
        axes.set_xlim(x_min, x_max)
        axes.set_ylim(z_min, z_max)
        axes.set_title(title, loc="left")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def fill(axes: Axes, surface: Surface, levels: Float[np.ndarray, " L"], names: tuple[str, str]) -> QuadContourSet:
    """The costs as filled contours; yellow is high. What is not finite stays blank."""
    points, costs = surface
    x, z = points.T.reshape(2, *costs.shape)
    filled = axes.contourf(x, z, np.ma.masked_invalid(costs), levels, cmap="cividis", extend="max")
    axes.set_xlabel(names[0])
    axes.set_ylabel(names[1])
    return filled


def draw_downhill(axes: Axes, points: Float[np.ndarray, "N 2"], gradients: Float[np.ndarray, "N 2"]) -> None:
    """Arrows of one length, none where the gradient is zero."""
    norm = np.linalg.norm(gradients, axis=1)
    moving = norm > 1e-9
    downhill = -gradients[moving] / norm[moving, None]
    axes.quiver(
        *points[moving].T,
        *downhill.T,
        color="white",
        edgecolor="black",
        linewidth=0.3,
        angles="xy",
        pivot="mid",
        width=0.007,
    )


def _draw_path(axes: Axes, method: str, points: Float[np.ndarray, "k _"], costs: Float[np.ndarray, " k"]) -> None:
    halo = [matplotlib.patheffects.withStroke(linewidth=3, foreground="white")]
    x, z = points[:, 0], points[:, 1]
    style = {**look(method), "markersize": 4, "markevery": max(1, len(x) // 25)}
    axes.plot(x, z, **style, linewidth=1.2, path_effects=halo)
    best = int(np.argmin(costs))
    axes.plot(x[best], z[best], **BEST, color=style["color"])
