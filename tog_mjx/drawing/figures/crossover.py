"""Which gradient is cheapest: its time against the number of decision variables, by method."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC, new_figure

_LOOKS: dict[str, dict[str, Any]] = {
    "J alone": {"color": "#888888", "linestyle": ":", "marker": ""},
    "reverse mode": {"color": "#1b1b1b", "linestyle": "-", "marker": "o"},
    "forward mode": {"color": "#0072b2", "linestyle": "--", "marker": "s"},
    "one stochastic sample": {"color": "#d55e00", "linestyle": "-.", "marker": "x"},
    "linear steps of C MuJoCo, all cores": {"color": "#cc79a7", "linestyle": "-", "marker": "v"},
    "differences of C MuJoCo, all cores": {"color": "#009e73", "linestyle": (0, (1, 1)), "marker": "^"},
}


def draw_crossover(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """A panel each simulator; `rows` of `tog_mjx.studies.benchmarks.sections.crossover`."""
    simulators = list(dict.fromkeys(row["simulator"] for row in rows))
    with rc_context(RC):
        figure = new_figure(4.6 * len(simulators), 4.2)
        for axes, simulator in zip(figure.subplots(1, len(simulators), squeeze=False)[0], simulators, strict=True):
            for method, look in _LOOKS.items():
                chosen = [row for row in rows if (row["simulator"], row["method"]) == (simulator, method)]
                axes.plot([row["variables"] for row in chosen], [row["ms"] for row in chosen], label=method, **look)
            axes.set_xscale("log", base=2)
            axes.set_yscale("log")
            axes.set_xlabel("decision variables")
            axes.set_ylabel("time of one gradient (ms)")
            axes.set_title(simulator, loc="left")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure
