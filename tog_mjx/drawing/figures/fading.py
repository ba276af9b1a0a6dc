"""Motions of any model seen from the side: what moves as fading silhouettes, with paths and marks over them."""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.figures.style import GUESS, RC, Window, new_figure

SNAPSHOTS = 7
_TRACK = "#a63d00"


class Shown(NamedTuple):
    """Positions of one motion, and points (x, z) in m: paths over the same states, and marks."""

    qpos: Float[np.ndarray, "k nq"]
    tracks: Float[np.ndarray, "k F 2"]
    marks: Float[np.ndarray, "m 2"]


def draw_motions(
    model: mujoco.MjModel,
    motions: Mapping[str, Shown],
    window: Window,
    *,
    title: str = "",
    names: tuple[str, str] = ("path", "mark"),
) -> Figure:
    """A panel for each motion, by its title, all of them with the same `window` [m].

    Args:
      names: of a path and of a mark, for the legend.
    """
    with rc_context({**RC, "axes.grid": False}):
        figure = new_figure(3.5 * len(motions), 3.9)
        panels = figure.subplots(1, len(motions), squeeze=False, sharex=True, sharey=True)[0]
        for axes, (of, motion) in zip(panels, motions.items(), strict=True):
            _draw_motion(axes, model, motion, names)
            planar.frame(axes, *window)
            axes.label_outer()
            axes.set_title(of, loc="left", fontsize=9)
        figure.legend(
            *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8
        )
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def _draw_motion(axes: Axes, model: mujoco.MjModel, motion: Shown, names: tuple[str, str]) -> None:
    data = mujoco.MjData(model)
    planar.draw(axes, [shape for shape in planar.place(model, data, motion.qpos[0]) if not shape.moves])
    moments = np.linspace(0, len(motion.qpos) - 1, SNAPSHOTS).round().astype(int)
    for moment, alpha in zip(moments, np.linspace(0.12, 1, SNAPSHOTS) ** 1.5, strict=True):
        shapes = planar.place(model, data, motion.qpos[moment])
        planar.draw(axes, [shape for shape in shapes if shape.moves], alpha)
    for i, track in enumerate(np.moveaxis(motion.tracks, 1, 0)):
        axes.plot(*track.T, color=_TRACK, linewidth=1.2, label="_" if i else names[0])
    axes.plot(*motion.marks.T, **{**GUESS, "marker": "P", "color": "#1b1b1b", "label": names[1]})
