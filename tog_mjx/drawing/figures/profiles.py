"""Performance profiles: the share of runs that have succeeded, against evaluations spent."""

import itertools

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC, new_figure

_COLORS = ("#1b1b1b", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#888888")
_LINES = ("-", "--", ":")


def draw_profiles(table: pd.DataFrame) -> Figure:
    """A panel each task on `penalty`, a line each method.

    `table` has a row each run: `task`, `simulator`, `method`, and `evaluations to success` (NaN: none).
    """
    table = table[table.simulator == "penalty"]
    looks = dict(zip(table.method.unique(), itertools.product(_LINES, _COLORS), strict=False))
    with rc_context(RC):
        figure = new_figure(9.6, 4.6)
        panels = figure.subplots(1, table.task.nunique(), squeeze=False)[0]
        for axes, (task, runs) in zip(panels, table.groupby("task"), strict=True):
            _plot(axes, runs, looks)
            axes.set_title(f"Box {task}", loc="left")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def _plot(axes: Axes, runs: pd.DataFrame, looks: dict[str, tuple[str, str]]) -> None:
    end = (runs.updates * runs.charge).max()
    for method, (line, color) in looks.items():
        spent = np.sort(runs["evaluations to success"][runs.method == method].dropna())
        share = np.arange(1, len(spent) + 1) / (runs.method == method).sum()
        x, y = [0, *spent, end], [0, *share, share[-1] if len(share) else 0]
        axes.step(x, y, where="post", color=color, linestyle=line, label=method, linewidth=1.3)
    axes.set_xlabel("evaluations of J, or their equivalent in gradients")
    axes.set_ylabel("share of runs that succeeded")
    axes.set_ylim(-0.02, 1.04)
    axes.set_xlim(0, end)
