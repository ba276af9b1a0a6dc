"""The curves behind what a check found."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC, new_figure

_COLORS, _STYLES = ("#1b1b1b", "#d55e00", "#0072b2", "#009e73", "#cc79a7"), ("-", "--", "-.", ":", "-")

_FEW = 6
"""Points up to which each has its tick."""


class _Look(NamedTuple):
    x: str
    label: str
    y_label: str
    scale: tuple[str, str]
    shown: tuple[str, ...] = ()
    """The curves shown: all, where none are named."""


_LOOKS = {
    "agreement": _Look("step", "step of the differences, relative", "relative error, change", ("log", "log")),
    "growth": _Look("step", "time step", "singular value, norm", ("linear", "log")),
    "time step": _Look("time step, relative", "time step, relative", "gradient norm", ("log", "linear")),
    "stiffness": _Look("stiffness, relative", "stiffness, relative", "gradient norm", ("log", "linear")),
    "solver": _Look("iterations", "solver iterations", "gradient norm", ("log", "linear")),
    "estimators": _Look(
        "sigma",
        "standard deviation of the perturbations, relative",
        "signal-to-noise, relative error",
        ("log", "log"),
        (
            "signal-to-noise, zeroth order",
            "signal-to-noise, first order",
            "error, exact",
            "error, first order",
            "error not resolved",
        ),
    ),
    "parity": _Look("step", "time step", "relative difference", ("linear", "log")),
}


Curves = Mapping[str, Sequence[int | float | None]]
"""Lists of equal length, by name."""


def has_figure(check: str, curves: Curves) -> bool:
    return check in _LOOKS and bool(curves)


def draw_curves(check: str, curves: Curves) -> Figure:
    """All curves of a check for which `has_figure`. What is None or not finite, or not positive on a logarithmic axis,
    is left out."""
    look = _LOOKS[check]
    x = np.array(curves[look.x], float)
    with rc_context(RC):
        figure = new_figure(5.6, 3.2)
        axes = figure.subplots()
        others = {
            name: np.array(y, float) for name, y in curves.items() if name != look.x and name in (look.shown or curves)
        }
        for i, (name, y) in enumerate(others.items()):
            drawn = np.where(y > 0, y, math.nan) if look.scale[1] == "log" else y
            style: dict[str, Any] = {"color": _COLORS[i % len(_COLORS)], "linestyle": _STYLES[i % len(_STYLES)]}
            axes.plot(x, np.where(np.isfinite(drawn), drawn, math.nan), marker="." * (len(x) < 70), label=name, **style)
        axes.set(xlabel=look.label, ylabel=look.y_label, xscale=look.scale[0])
        if look.scale[1] == "log" and any((y > 0).any() for y in others.values()):
            axes.set_yscale("log")
        if look.scale[0] == "log" and len(x) <= _FEW:
            axes.set_xticks(x, [f"{number:g}" for number in x])
            axes.set_xticks([], minor=True)
        if len(others) > 1:
            figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    return figure
