"""The controls of a motion over its time, in a strip below the picture."""

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tog_mjx.drawing.viewing.shown import Motion

SHARE = 0.16
"""Of a frame's height."""
_LEAST = 60
"""Pixels of a frame's height for which there is a strip."""
_DPI = 100
_NAMED = 6
"""Actuators up to which each is named."""
_ROUNDING = 1e-5
_FONT = 0.12
"""Points for a pixel of height."""
_MARK, _DARK = 2, (27, 27, 27)
"""Width in pixels, and colour, of the line at a moment."""


def strip_height(motion: Motion, height: int) -> int:
    """Pixels of a strip in a frame so high: 0 where controls do not change, as nothing is to be seen then."""
    if motion.ctrl is None or not _changing(motion.ctrl) or height < _LEAST:
        return 0
    return round(SHARE * height / 2) * 2


def strips(model: mujoco.MjModel, motion: Motion, size: tuple[int, int]) -> UInt8[np.ndarray, "n h w 3"]:
    """One strip of `size` (width, height) in pixels for each moment, with a line there.

    Each control that changes is drawn between its least and its largest, those of its range if it has one.
    """
    ground = _lines(model, motion.time, np.asarray(motion.ctrl, float), size)
    frames = np.repeat(ground[None], len(motion.time), axis=0)
    places = np.interp(motion.time, [motion.time[0], motion.time[-1]], [0, size[0] - _MARK]).round().astype(int)
    for frame, at in zip(frames, places, strict=True):
        frame[:, at : at + _MARK] = _DARK
    return frames


def _lines(
    model: mujoco.MjModel, time: Float[np.ndarray, " T"], ctrl: Float[np.ndarray, "T nu"], size: tuple[int, int]
) -> UInt8[np.ndarray, "h w 3"]:
    width, height = size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    changing = _changing(ctrl)
    names = [model.actuator(i).name for i in changing]
    is_named = len(names) <= _NAMED and all(names)
    axes.set(xlim=(time[0], time[-1]), ylim=(-0.1, 1.5 if is_named else 1.1))
    axes.set_axis_off()
    shares = _shares(model, ctrl)
    for i, name in zip(changing, names, strict=True):
        axes.plot(time, shares[:, i], linewidth=1.2, label=name)
    if is_named:
        axes.legend(loc="upper left", ncols=_NAMED, handlelength=1, fontsize=_FONT * height, frameon=False, borderpad=0)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3]


def _changing(ctrl: Float[np.ndarray, "T nu"]) -> list[int]:
    """The controls that change by more than rounding."""
    return np.flatnonzero(np.ptp(ctrl, axis=0) > _ROUNDING * np.abs(ctrl).max(axis=0)).tolist()


def _shares(model: mujoco.MjModel, ctrl: Float[np.ndarray, "T nu"]) -> Float[np.ndarray, "T nu"]:
    low, high = ctrl.min(axis=0), ctrl.max(axis=0)
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, np.minimum(low, model.actuator_ctrlrange[:, 0]), low)
    high = np.where(limited, np.maximum(high, model.actuator_ctrlrange[:, 1]), high)
    return (ctrl - low) / np.where(high > low, high - low, 1.0)
