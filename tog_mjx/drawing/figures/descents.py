"""Cost against iteration, a curve for each method, and the iterate where each was least."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import BEST, PUBLISHED, RC, Window, look, new_figure

Traces = Mapping[str, Float[np.ndarray, " _"]]
"""Costs of iterates, the initial guess first, by method."""


def draw_descents(
    traces: Traces,
    published: Traces | None = None,
    *,
    title: str = "",
    cost: str = "cost $J$",
    inset: Window | None = None,
) -> Figure:
    """A curve for each of the `traces`, a star at its least cost, and dotted under it the `published` one, if any.

    Args:
      inset: iterations and costs of a part that is shown larger too.
    """
    with rc_context(RC):
        figure = new_figure()
        axes = figure.subplots()
        _plot(axes, traces, published or {})
        axes.set_xlabel("iteration (parameter updates)")
        axes.set_ylabel(cost)
        axes.set_title(title, loc="left")
        axes.set_ylim(0, 1.1 * max(float(costs.max()) for costs in traces.values()))
        axes.plot([], [], **BEST, color="#7a7a7a", label="best iterate")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
        if inset:
            larger = axes.inset_axes((0.52, 0.3, 0.46, 0.36), xlim=inset[0], ylim=inset[1])
            _plot(larger, traces, published or {}, markersize=3.0)
            larger.tick_params(labelsize=7)
            axes.indicate_inset_zoom(larger, edgecolor="#555555")
    return figure


def _plot(axes: Axes, traces: Traces, published: Traces, markersize: float = 4.0) -> None:
    every = max(1, max(len(costs) for costs in traces.values()) // 25)
    for method, costs in traces.items():
        style = look(method)
        if len(known := published.get(method, ())):
            axes.plot(known, **PUBLISHED, color=style["color"], label=f"published, {method}")
        axes.plot(costs, **style, markersize=markersize, markevery=every, linewidth=1.3)
        best = int(np.argmin(costs))
        axes.plot(best, costs[best], **BEST, color=style["color"])
