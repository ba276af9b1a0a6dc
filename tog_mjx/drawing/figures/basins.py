"""Basins: the best cost that a descent finds, over its initial guesses in a window of two variables."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import GUESS, RC, Window, new_figure

SUCCEEDED = "#d55e00"


class View(NamedTuple):
    """Of a task: the window of its guesses, the guess [2] marked in it, and the highest J shown."""

    window: Window
    guess: np.ndarray
    highest: float


def draw_basins(table: pd.DataFrame, views: Mapping[str, View]) -> Figure:
    """A row each task: the landscape, and for each method the best J found from each point, and where it succeeded.

    `table` has a row each run: `task`, `method`, `seed` (the number of the point), `first`, `best` and `succeeded`.
    """
    tasks, methods = table.task.unique(), table.method.unique()
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(3.1 * (1 + len(methods)) + 0.6, 3.2 * len(tasks) + 0.4)
        panels = figure.subplots(len(tasks), 1 + len(methods), squeeze=False)
        for row, name in zip(panels, tasks, strict=True):
            view, limits = views[name], Normalize(0, views[name].highest)
            runs = table[table.task == name].sort_values("seed")
            found = {method: runs[runs.method == method] for method in methods}
            _plot(row[0], view, _square(found[methods[0]]["first"]), limits)
            row[0].set_title(f"Box {name}: J", loc="left")
            for axes, (method, some) in zip(row[1:], found.items(), strict=True):
                _plot(axes, view, _square(some.best), limits, _square(some.succeeded))
                axes.set_title(f"{method}: {some.succeeded.mean():.0%}", loc="left")
            bar = ScalarMappable(limits, "cividis")
            figure.colorbar(bar, ax=row, label=rf"cost $J_\mathrm{{{name}}}$", extend="max")
        row[0].plot([], [], "s", color=SUCCEEDED, label="success")
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _square(values: pd.Series) -> np.ndarray:
    """In the order of `Plane.grid`: row i has the i-th z."""
    size = math.isqrt(len(values))
    return values.to_numpy().reshape(size, size)


def _plot(
    axes: Axes,
    view: View,
    costs: Float[np.ndarray, "N N"],
    limits: Normalize,
    succeeded: Bool[np.ndarray, "N N"] | None = None,
) -> None:
    """Costs as colours, and one colour over them where it succeeded. What is not finite stays blank."""
    x, z = (np.linspace(*side, len(costs)) for side in view.window)
    axes.pcolormesh(x, z, np.ma.masked_invalid(costs), norm=limits, cmap="cividis", shading="nearest", rasterized=True)
    if succeeded is not None:
        flat = ListedColormap([SUCCEEDED])
        axes.pcolormesh(x, z, np.ma.masked_where(~succeeded, succeeded), cmap=flat, shading="nearest", rasterized=True)
    axes.plot(*view.guess, **GUESS)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("z (m)")
