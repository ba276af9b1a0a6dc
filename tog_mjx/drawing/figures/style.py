"""One look for all figures: legible in greyscale and to colour-blind eyes, drawn without a display."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tog_mjx.running.storage import atomic_write

Window = tuple[tuple[int | float, int | float], tuple[int | float, int | float]]
"""From and to, along the first axis and along the second."""

RC: dict[Any, Any] = {
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
}

METHOD: dict[str, dict[str, Any]] = {
    "exact": {"color": "#1b1b1b", "linestyle": "-", "marker": "o", "label": "exact gradient"},
    "saltation": {"color": "#0072b2", "linestyle": "-.", "marker": "s", "label": "gradient with the jumps"},
    "stochastic": {"color": "#d55e00", "linestyle": "--", "marker": "x", "label": "stochastic gradient"},
}


def look(method: str) -> dict[str, Any]:
    """Of a method's curve: of "exact, adam" that of "exact"; of one that is none of `METHOD` a plain line."""
    plain = {"color": "#009e73", "linestyle": ":", "marker": ".", "label": method}
    return METHOD.get(method.partition(",")[0], plain)


GUESS: dict[str, Any] = {
    "color": "#0072b2",
    "marker": "D",
    "markersize": 7,
    "linestyle": "none",
    "markeredgecolor": "white",
    "label": "initial guess",
    "zorder": 6,
}
PUBLISHED: dict[str, Any] = {"linestyle": ":", "linewidth": 1.6, "alpha": 0.7, "zorder": 1}

BEST: dict[str, Any] = {"marker": "*", "markersize": 11, "linestyle": "none", "markeredgecolor": "white", "zorder": 5}


def new_figure(width: float = 6.4, height: float = 4.0) -> Figure:
    """A figure (sizes in inches) that belongs to no window."""
    with rc_context(RC):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        return figure


def save_figure(figure: Figure, path: Path, suffixes: Sequence[str] = ()) -> None:
    """Writes the figure, atomically, in the format of the path's suffix, and beside it in those of `suffixes`."""
    for name in (path, *(path.with_suffix(suffix) for suffix in suffixes)):
        with rc_context(RC), atomic_write(name) as file:
            figure.savefig(file, format=name.suffix.removeprefix("."), dpi=160)
