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


_FLAT = 0.05
"""Relative change over a curve below which it says no more than one number."""
_SAME = 0.01
"""Relative difference below which two curves are one."""
_ROUNDING = 1e-12
"""Relative differences below this are of the arithmetic."""


class _Look(NamedTuple):
    """How a check's curves are drawn. A curve says more than the finding's sentence only where it has enough `points`;
    a figure, only with its `main` curve, if there is one, and, if `of_concern`, where the finding is not fine."""

    x: str
    label: str
    y_label: str
    scale: tuple[str, str]
    caption: str
    shown: tuple[str, ...] = ()
    """The curves shown: all, where none are named."""
    main: str = ""
    points: int = 4
    of_concern: bool = True


_LOOKS = {
    "agreement": _Look(
        "step",
        "step of the differences, relative",
        "relative error, change",
        ("log", "log"),
        "How far the derivative is from central differences, over their step, and how much those change from one step "
        "to the next: they can be believed where both are low.",
        ("error", "change"),
        main="error",
    ),
    "agreement, along a line": _Look(
        "displacement",
        "change of the variable, in its units",
        "change of the output",
        ("linear", "linear"),
        "The output that differs most along the variable in which it does, beside the straight lines of the derivative "
        "and of the slope over the whole window: what the derivative does not see is between them.",
        ("function", "along the gradient", "along the slope over the window"),
        main="function",
    ),
    "growth": _Look(
        "step",
        "time step",
        "singular value, norm",
        ("linear", "log"),
        "How a small change grows over the motion: of the initial positions, at most and at least, and the derivative "
        "of the state; a straight rise is chaos, a fall is a motion that forgets.",
        of_concern=False,
    ),
    "time step": _Look(
        "time step, relative",
        "time step, relative",
        "gradient norm",
        ("log", "linear"),
        "The length of the gradient over the time step: it is that of the physics where the curve has become flat.",
    ),
    "solver": _Look(
        "iterations",
        "solver iterations",
        "gradient norm",
        ("log", "linear"),
        "The length of the gradient over the iterations of the solver: enough are made where the curve is flat.",
    ),
    "estimators": _Look(
        "sigma",
        "standard deviation of the perturbations, relative",
        "signal-to-noise, relative error",
        ("log", "log"),
        "Signal-to-noise of stochastic gradients, and the errors of gradients against that of the smoothed function, "
        "over how wide it is smoothed: an estimator is of use where its signal is above 1 and its error below.",
        (
            "signal-to-noise, zeroth order",
            "signal-to-noise, first order",
            "error, exact",
            "error, first order",
            "error not resolved",
        ),
        points=3,
    ),
    "parity": _Look(
        "step",
        "time step",
        "relative difference",
        ("linear", "log"),
        "How far a time step of MJX, and its derivative, are from those of C MuJoCo, along the motion.",
    ),
}


Curves = Mapping[str, Sequence[int | float | None]]
"""Lists of equal length, by name."""


class Drawn(NamedTuple):
    """A figure, its name, and what it shows, in a sentence."""

    name: str
    caption: str
    figure: Figure


def figures(check: str, level: str, curves: Curves) -> list[Drawn]:
    """Those of a check whose curves are `informative`."""
    names = [name for name in _LOOKS if name.partition(",")[0] == check and informative(name, level, curves)]
    return [Drawn(name, _LOOKS[name].caption, draw_curves(name, level, curves)) for name in names]


def informative(name: str, level: str, curves: Curves) -> dict[str, np.ndarray]:
    """The curves of a figure that say what the finding's sentence and its numbers do not, if there are any.

    Left out are curves that are flat, of a few points, on one line with another, or of mere rounding. What is None or
    not finite, or not positive on a logarithmic axis, is NaN.
    """
    look = _LOOKS.get(name)
    if look is None or not curves or (level == "fine" and look.of_concern):
        return {}
    found: dict[str, np.ndarray] = {}
    for curve in look.shown or [curve for curve in curves if curve != look.x]:
        y = np.array(curves.get(curve, ()), float)
        y = np.where(np.isfinite(y) & ((y > 0) | (look.scale[1] == "linear")), y, math.nan)
        seen = y[~np.isnan(y)]
        is_small = seen.size < look.points or (look.scale[1] == "log" and seen.max() < _ROUNDING)
        if is_small or np.ptp(seen) <= _FLAT * np.abs(seen).max():
            continue
        if not any(np.allclose(y, other, rtol=_SAME, atol=0, equal_nan=True) for other in found.values()):
            found[curve] = y
    return found if not look.main or look.main in found else {}


def draw_curves(name: str, level: str, curves: Curves) -> Figure:
    """The `informative` curves of that figure, which must be some."""
    look, drawn = _LOOKS[name], informative(name, level, curves)
    x = np.array(curves[look.x], float)
    with rc_context(RC):
        figure = new_figure(5.6, 3.2)
        axes = figure.subplots()
        for i, (curve, y) in enumerate(drawn.items()):
            style: dict[str, Any] = {"color": _COLORS[i % len(_COLORS)], "linestyle": _STYLES[i % len(_STYLES)]}
            axes.plot(x, y, marker="." * (len(x) < 70), label=curve, **style)
        axes.set(xlabel=look.label, ylabel=look.y_label, xscale=look.scale[0], yscale=look.scale[1])
        if look.scale[0] == "log" and len(x) <= _FEW:
            axes.set_xticks(x, [f"{number:g}" for number in x])
            axes.set_xticks([], minor=True)
        figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    return figure
