"""Figures 3 and 6: cost against iteration, both methods, and where the published run ended up."""

from collections.abc import Mapping

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import BEST, METHOD, PUBLISHED, RC, new_figure
from tog_mjx.paper.published import published
from tog_mjx.solving.descent import Descent

FIGURE_NUMBER = {"flip": 3, "grasp": 6}
_INSET_ITERATIONS = {"flip": None, "grasp": 100}
"""The inset shows the flip's last iterates, near zero, and the grasp's first hundred, in which exact descent lifts."""


def draw_descents(task: str, simulator: str, descents: Mapping[str, Descent]) -> Figure:
    """Figure 3 (flip) or 6 (grasp) of the paper.

    Args:
      task, simulator: names, for titles and the published traces.
      descents: by method, "exact" and "stochastic" or one of them.
    """
    with rc_context(RC):
        figure = new_figure()
        axes = figure.subplots()
        _plot(axes, task, descents)
        axes.set_xlabel("iteration (parameter updates)")
        axes.set_ylabel(rf"cost $J_\mathrm{{{task}}}$")
        axes.set_title(f"Box {task} on {simulator}", loc="left")
        axes.set_ylim(0, 1.1 * max(float(d.costs.max()) for d in descents.values()))
        axes.plot([], [], **BEST, color="#7a7a7a", label="best iterate")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
        _add_inset(axes, task, descents)
    return figure


def _plot(axes: Axes, task: str, descents: Mapping[str, Descent], markersize: float = 4.0) -> None:
    longest = max(len(descent.costs) for descent in descents.values())
    for method, descent in descents.items():
        trace = published(task, method)
        if trace.costs.size:
            axes.plot(trace.costs, **PUBLISHED, color=METHOD[method]["color"], label=f"published, {method}")
        axes.plot(
            descent.costs, **METHOD[method], markersize=markersize, markevery=max(1, longest // 25), linewidth=1.3
        )
        best = descent.best_iteration
        axes.plot(best, descent.costs[best], **BEST, color=METHOD[method]["color"])


def _add_inset(axes: Axes, task: str, descents: Mapping[str, Descent]) -> None:
    inset = axes.inset_axes((0.52, 0.3, 0.46, 0.36))
    _plot(inset, task, descents, markersize=3.0)
    longest = max(len(d.costs) for d in descents.values()) - 1
    limit = _INSET_ITERATIONS[task]
    if limit is not None:
        inset.set_xlim(-1, min(limit, longest) + 1)
        inset.set_ylim(0, 1.05 * min(1.0, max(float(np.max(d.costs)) for d in descents.values())))
    else:
        inset.set_xlim(longest * 0.2, longest * 1.03)
        inset.set_ylim(0, 0.3)
    inset.tick_params(labelsize=7)
    axes.indicate_inset_zoom(inset, edgecolor="#555555")
