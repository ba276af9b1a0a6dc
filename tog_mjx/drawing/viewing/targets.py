"""What a motion is meant to reach: sites named for it, setpoints, and mocap bodies."""

import re

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.viewing.shown import markers

COLOR = (0.0, 0.62, 0.45, 1.0)
"""Of a target whose file gives none: that of the tasks' setpoints."""
_NAMED = re.compile("target|goal", re.IGNORECASE)


def target_sites(model: mujoco.MjModel) -> list[int]:
    """The visible sites that are called a target, a goal or a setpoint."""
    named = [site for site in range(model.nsite) if _NAMED.search(model.site(site).name)]
    return [site for site in sorted({*named, *markers(model).values()}) if planar.is_visible_site(model, site)]


def bare_mocaps(model: mujoco.MjModel) -> list[int]:
    """The mocap bodies of which nothing is to be seen."""
    geoms = {int(model.geom_bodyid[geom]) for geom in range(model.ngeom) if planar.is_visible(model, geom)}
    sites = {int(model.site_bodyid[site]) for site in range(model.nsite) if planar.is_visible_site(model, site)}
    return [body for body in np.flatnonzero(model.body_mocapid >= 0).tolist() if body not in geoms | sites]


def target_ends(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "k 3"]:
    """Corners of boxes around them; `data` must hold their poses."""
    sites = target_sites(model)
    centres = np.concatenate([data.site_xpos[sites], data.xpos[bare_mocaps(model)]])
    radii = np.zeros(len(centres))
    radii[: len(sites)] = model.site_size[sites].max(axis=1, initial=0)
    return (centres[:, None] + radii[:, None, None] * planar.CORNERS).reshape(-1, 3)


def show_targets(model: mujoco.MjModel, radius: float) -> None:
    """Gives a target site a size (m) and a colour, where its file leaves both to MuJoCo: a grey dot of 5 mm."""
    usual = mujoco.MjSpec().default.site
    for site in target_sites(model):
        is_usual = (model.site_rgba[site] == usual.rgba.astype(np.float32)).all() and model.site_matid[site] < 0
        if is_usual and (model.site_size[site] == usual.size).all():
            model.site_rgba[site], model.site_size[site] = COLOR, radius
