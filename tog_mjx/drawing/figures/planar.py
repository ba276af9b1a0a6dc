"""Any MuJoCo model seen from the side: outlines of its geoms in the x-z plane, drawn without OpenGL.

x points right, z up; the view is orthographic, along the y axis.
"""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib.patches
import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from scipy.spatial import ConvexHull, QhullError

_VISIBLE_GROUPS = 3
"""MuJoCo's viewers show geoms of groups 0 to 2 unless told otherwise."""
_FAR = 100.0
"""Half the side of an infinite plane, and the depth of the ground below it, in m."""
_ROUND = 48
"""Points of a circle."""
CORNERS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3)
"""Of a cube of side 2."""


class Outline(NamedTuple):
    """The silhouette of a geom: `polygon` [k, 2] of (x, z) in m, and its colour (red, green, blue, alpha).

    `moves` is false where the geom is fixed to the world.
    """

    name: str
    polygon: np.ndarray
    color: tuple[float, ...]
    moves: bool


def outlines(model: mujoco.MjModel, data: mujoco.MjData) -> list[Outline]:
    """The silhouettes of the visible geoms, farthest from the eye first. `data` must hold the geoms' poses."""
    found = []
    for i in np.argsort(-data.geom_xpos[:, 1], kind="stable"):
        if not is_visible(model, int(i)):
            continue
        points = data.geom_xpos[i] + _surface(model, int(i)) @ data.geom_xmat[i].reshape(3, 3).T
        moves = bool(model.body_weldid[model.geom_bodyid[i]])
        found.append(Outline(model.geom(int(i)).name, _hull(points[:, [0, 2]]), _color(model, int(i)), moves))
    return found


def is_visible(model: mujoco.MjModel, geom: int, opacity: float = 0.0) -> bool:
    """Whether MuJoCo's viewers show a geom, and it is less transparent than that."""
    return bool(model.geom_group[geom] < _VISIBLE_GROUPS) and _color(model, geom)[3] > opacity


def is_visible_site(model: mujoco.MjModel, site: int) -> bool:
    """The same of a site."""
    return bool(model.site_group[site] < _VISIBLE_GROUPS and model.site_rgba[site, 3] > 0)


def site_outlines(model: mujoco.MjModel, data: mujoco.MjData) -> list[Outline]:
    """The silhouettes of the visible sites, as `outlines`. Their materials are left out."""
    found = []
    for i in np.argsort(-data.site_xpos[:, 1], kind="stable").tolist():
        if not is_visible_site(model, i):
            continue
        color = tuple(float(c) for c in model.site_rgba[i])
        surface = _primitive(mujoco.mjtGeom(int(model.site_type[i])), model.site_size[i])
        points = data.site_xpos[i] + surface @ data.site_xmat[i].reshape(3, 3).T
        moves = bool(model.body_weldid[model.site_bodyid[i]])
        found.append(Outline(model.site(i).name, _hull(points[:, [0, 2]]), color, moves))
    return found


def textured_planes(model: mujoco.MjModel) -> list[int]:
    """The visible planes whose file gives them a texture, which is not drawn here."""
    planes = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_matid >= 0)).tolist()
    return [i for i in planes if is_visible(model, i) and (model.mat_texid[model.geom_matid[i]] >= 0).any()]


def tiles(
    model: mujoco.MjModel, data: mujoco.MjData, planes: Sequence[int], x: tuple[float, float], side: float
) -> list[Outline]:
    """Every other tile of level planes, of that side in m, as blocks of the ground between two x."""
    found = []
    for i in planes:
        if data.geom_xmat[i].reshape(3, 3)[2, 2] < 1 - 1e-9:  # Only a level one begins at a line.
            continue
        at, half = data.geom_xpos[i], model.geom_size[i, 0] or np.inf
        color = tuple(0.84 * c for c in _color(model, i)[:3])
        first, last = np.floor((np.array(x) - at[0]) / side).astype(int)
        for k in range(first, last + 1):
            if k % 2 == 0 and side * k < half and side * (k + 1) > -half:
                ends = at[0] + np.clip(side * np.array([k, k + 1]), -half, half)
                corners = np.array([[a, at[2] - b] for a, b in zip(ends.repeat(2), (0, side, side, 0), strict=True)])
                found.append(Outline(model.geom(i).name, corners, (*color, 1.0), False))
    return found


def balls(places: Float[np.ndarray, "k 3"], radius: float, color: tuple[float, ...]) -> list[Outline]:
    """Their silhouettes."""
    circle = radius * _primitive(mujoco.mjtGeom.mjGEOM_SPHERE, np.ones(3))[:, [0, 2]]
    return [Outline("", _hull(place[[0, 2]] + circle), color, False) for place in places]


def place(model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, " nq"]) -> list[Outline]:
    """The silhouettes of the visible geoms in these positions; `data` is moved there."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return outlines(model, data)


def draw(
    axes: Axes, shapes: Sequence[Outline], alpha: float = 1.0, has_edge: bool = True
) -> list[matplotlib.patches.Polygon]:
    """Adds the silhouettes, filled, with a darker edge."""
    patches = []
    for shape in shapes:
        face = (*shape.color[:3], alpha * shape.color[3])
        edge = (*(0.45 * c for c in shape.color[:3]), alpha)
        patch = matplotlib.patches.Polygon(
            shape.polygon, closed=True, facecolor=face, edgecolor=edge, linewidth=0.8 * has_edge
        )
        patch.set_gid(shape.name)
        axes.add_patch(patch)
        patches.append(patch)
    return patches


def frame(axes: Axes, x: tuple[float, float], z: tuple[float, float]) -> None:
    """The window of the view, in m, one scale on both axes."""
    axes.set_xlim(*x)
    axes.set_ylim(*z)
    axes.set_aspect("equal")
    axes.locator_params("x", nbins=6)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("z (m)")


def _color(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    material = model.geom_matid[geom]
    has_own = not np.array_equal(model.geom_rgba[geom], [0.5, 0.5, 0.5, 1])  # MuJoCo's default
    rgba = model.geom_rgba[geom] if has_own or material < 0 else model.mat_rgba[material]
    return tuple(float(c) for c in rgba)


def _surface(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points [k, 3] in the geom's frame, whose convex hull is the geom or contains it."""
    match kind := mujoco.mjtGeom(int(model.geom_type[geom])):
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            return model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        case mujoco.mjtGeom.mjGEOM_HFIELD | mujoco.mjtGeom.mjGEOM_SDF:  # The box that bounds it.
            centre, half = model.geom_aabb[geom].reshape(2, 3)
            return centre + half * CORNERS
        case _:
            return _primitive(kind, model.geom_size[geom])


def _primitive(kind: mujoco.mjtGeom, size: np.ndarray) -> np.ndarray:
    polar, around = np.meshgrid(np.linspace(0, np.pi, _ROUND // 2 + 1), np.linspace(0, 2 * np.pi, _ROUND))
    sphere = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    sphere = sphere.reshape(-1, 3)
    ends = np.array([[0, 0, -1], [0, 0, 1]])[:, None]
    match kind:
        case mujoco.mjtGeom.mjGEOM_PLANE:
            return CORNERS * [size[0] or _FAR, size[1] or _FAR, _FAR / 2] - [0, 0, _FAR / 2]
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return size[0] * sphere
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return size * sphere
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return (size[0] * sphere + size[1] * ends).reshape(-1, 3)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            rim = np.stack([np.cos(around[:, 0]), np.sin(around[:, 0]), 0 * around[:, 0]], -1)
            return (size[0] * rim + size[1] * ends).reshape(-1, 3)
        case _:
            return size * CORNERS


def _hull(points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "m 2"]:
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # Seen edge on: a line.
        return points[[points[:, 0].argmin(), points[:, 0].argmax()]]
