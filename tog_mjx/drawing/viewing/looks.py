"""Light, colours and a floor for what a file leaves without them."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.viewing.targets import bare_mocaps, show_targets

_GREY = (0.5, 0.5, 0.5, 1)
"""The colour of a geom whose file gives none."""
_COLORS = (
    (0.9, 0.6, 0.3, 1),
    (0.35, 0.55, 0.8, 1),
    (0.4, 0.7, 0.5, 1),
    (0.8, 0.5, 0.65, 1),
    (0.85, 0.78, 0.4, 1),
    (0.55, 0.48, 0.75, 1),
)
_FLOOR = (0.82, 0.84, 0.87, 1)


_TILES, _DOT = 6, 0.012
"""Tiles of a floor across the height of a view, about; and the radius of a target, in that height."""


class Scenery(NamedTuple):
    """What is added to a file's own: a light, a bright background, tiles of a side (m) on some planes, and balls of a
    radius (m) in places [m, 3]."""

    is_dark: bool
    has_sky: bool
    floors: list[int]
    tile: float
    marks: Float[np.ndarray, "m 3"]
    radius: float


def dress(model: mujoco.MjModel, data: mujoco.MjData, height: float) -> Scenery:
    """Brightens a model whose file has no light, colours what has MuJoCo's grey, bodies that move and planes, and shows
    targets. `height` is that of a view, in m.

    What a file chooses is left as it is.
    """
    seen = [i for i in range(model.ngeom) if planar.is_visible(model, i)]
    grey = [i for i in seen if model.geom_matid[i] < 0 and (model.geom_rgba[i] == _GREY).all()]
    moving = [i for i in grey if model.body_weldid[model.geom_bodyid[i]]]
    bodies = np.unique(model.geom_bodyid[moving]).tolist()
    for geom in moving:
        model.geom_rgba[geom] = _COLORS[bodies.index(model.geom_bodyid[geom]) % len(_COLORS)]
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    floors = [i for i in grey if is_plane[i] and i not in moving]
    model.geom_rgba[floors] = _FLOOR
    show_targets(model, _DOT * height)
    has_sky = bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())
    marks = data.mocap_pos[model.body_mocapid[bare_mocaps(model)]]
    return Scenery(_light(model), has_sky, floors, _round(height / _TILES), marks, _DOT * height)


def _round(length: float) -> float:
    """To 1, 2 or 5 of some power of ten."""
    power = 10 ** np.floor(np.log10(length))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= length * (1 + 1e-9)))


def _light(model: mujoco.MjModel) -> bool:
    """Whether there was no light."""
    given, usual = model.vis.headlight, mujoco.MjSpec().visual.headlight
    if model.nlight or (given.ambient != usual.ambient).any() or (given.diffuse != usual.diffuse).any():
        return False
    given.ambient[:], given.diffuse[:], given.specular[:] = 0.35, 0.35, 0
    return True
