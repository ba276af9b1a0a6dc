"""What tells beforehand which gradient gains more: a statistic of J at an iterate against the gain of a step."""

from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC, new_figure

_LOOKS: dict[str, dict[str, Any]] = {
    "flip": {"color": "#0072b2", "marker": "o"},
    "grasp": {"color": "#d55e00", "marker": "x"},
}
_NAMES = {
    "gradient": "norm of the exact gradient (1/m)",
    "snr0": "signal-to-noise ratio, zeroth order",
    "snr1": "signal-to-noise ratio, first order",
    "cosine": "cosine of exact and smoothed gradient",
    "bias": "relative error of the exact gradient",
    "bias1": "relative error of first order",
    "flatness": "share of points with J unchanged",
    "roughness": "roughness: rest of a linear fit",
    "steepness": "steepness: largest over median gradient",
}
_LOGARITHMIC = ("gradient", "bias", "bias1", "steepness")


def draw_why(table: pd.DataFrame, statistic: str) -> Figure:
    """A panel each sigma, the smaller one first; `table` of the study `why`."""
    widths = table.groupby("task").sigma.agg(["min", "max"])
    panels = {"sigma = 1 cm": widths["min"], "sigma of Table I": widths["max"]}
    with rc_context(RC):
        figure = new_figure(8.6, 4.0)
        for axes, (title, sigma) in zip(figure.subplots(1, 2, sharey=True), panels.items(), strict=True):
            for task, look in _LOOKS.items():
                some = table[(table.task == task) & (table.sigma == sigma[task])]
                gain = some["gain, exact"] - some["gain, equal"]
                axes.scatter(some[statistic], gain, s=22, alpha=0.8, label=task, **look)
            axes.axhline(0, color="#555555", linewidth=0.8)
            axes.set_yscale("symlog", linthresh=1e-4)
            if statistic in _LOGARITHMIC:
                axes.set_xscale("log")
            axes.set_xlabel(_NAMES[statistic])
            axes.set_title(title, loc="left")
        figure.axes[0].set_ylabel("J lower by exact than by\nzeroth order of equal cost, 1 cm")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure
