"""Figures 3 and 6 over seeds: cost against iteration, as bands of quantiles."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC, look, new_figure

QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)


def quantiles(costs: Float[np.ndarray, "M N"]) -> Float[np.ndarray, "5 N"]:
    """`QUANTILES` over the runs that have a finite cost in that iteration."""
    return np.nanquantile(np.where(np.isfinite(costs), costs, np.nan), QUANTILES, axis=0)


def draw_bands(
    traces: Mapping[tuple[str, str, str], Float[np.ndarray, "M N"]], success: Mapping[str, int | float]
) -> Figure:
    """A row each task, a column each simulator: the median of J, 10 to 90 % and all of the runs.

    Args:
      traces: by task, simulator and method, "exact, ...", "saltation, ..." or "stochastic, ...": costs of M runs; one
        run is a line.
      success: by task, the cost that counts as success.
    """
    tasks, simulators, _ = (list(dict.fromkeys(names)) for names in zip(*traces, strict=True))
    with rc_context(RC):
        figure = new_figure(max(4.4, 3.2 * len(simulators)), 2.7 * len(tasks) + 0.5)
        panels = figure.subplots(len(tasks), len(simulators), squeeze=False, sharex="row", sharey="row")
        for (task, simulator, method), costs in traces.items():
            _plot(panels[tasks.index(task), simulators.index(simulator)], method, costs)
        for (row, column), axes in np.ndenumerate(panels):
            axes.axhline(success[tasks[row]], color="#555555", linestyle=":", linewidth=1, label="success")
            axes.set_title(f"Box {tasks[row]} on {simulators[column]}", loc="left")
            axes.set_yscale("log")
            axes.set_xlim(left=0)
            if axes.get_xlim()[1] > 100:  # Exact descent has a tenth of the grasp's iterations.
                axes.set_xscale("symlog", linthresh=10)
        for axes in panels[-1]:
            axes.set_xlabel("iteration (parameter updates)")
        for axes, task in zip(panels[:, 0], tasks, strict=True):
            axes.set_ylabel(rf"cost $J_\mathrm{{{task}}}$")
        looks = [axes.get_legend_handles_labels() for axes in panels.flat]
        named = {label: look for some in looks for look, label in zip(*some, strict=True)}
        columns = min(5, 2 * len(simulators))
        figure.legend(named.values(), named, loc="outside lower center", ncols=columns, frameon=False, fontsize=8)
    return figure


def _plot(axes: Axes, method: str, costs: Float[np.ndarray, "M N"]) -> None:
    least, low, median, high, most = quantiles(costs)
    style, iterations = look(method), np.arange(len(median))
    name = style["label"] + (", median" if len(costs) > 1 else "")
    axes.plot(iterations, median, color=style["color"], linestyle=style["linestyle"], linewidth=1.4, label=name)
    if len(costs) > 1:
        axes.fill_between(iterations, low, high, color=style["color"], alpha=0.35, linewidth=0, label="10 to 90 %")
        axes.fill_between(iterations, least, most, color=style["color"], alpha=0.15, linewidth=0, label="all seeds")
