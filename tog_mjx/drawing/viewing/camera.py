"""What a frame shows: all that moves, from a scene's own camera or from a place chosen for the motion."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.figures import planar
from tog_mjx.drawing.viewing import framing
from tog_mjx.drawing.viewing.shown import markers
from tog_mjx.drawing.viewing.targets import target_ends

_CAMERA = "plane"
"""Looks along y, orthographically."""
_FREE_CAMERA_DISTANCE = 1.5
"""In extents of the model: how far MuJoCo's free camera stands from the model's centre."""
_FREE_CAMERA_HEIGHT = 1.25
"""In extents of the model: what it shows at the centre."""
_OBLIQUE, _SIDE, _ABOVE = (120.0, -25.0), -10.0, -60.0
"""Azimuth and elevation (degrees) from which a scene is seen; elevation of one whose bodies stay in an upright plane,
and of one whose bodies stay in a level one."""
_SEE_THROUGH = 0.3
"""Opacity below which a geom is a hint, no body."""
_PARALLEL = 1e-6


class Window(NamedTuple):
    """The centre (x, z) and the height of a view along y, in m."""

    x: float
    z: float
    height: float


class Views(NamedTuple):
    """Of each frame what MuJoCo's free camera looks at [n, 3], from a distance in m, under an azimuth and an elevation
    in degrees; and the Window [n, 3] of a drawing from the side."""

    lookat: Float[np.ndarray, "n 3"]
    distance: float
    azimuth: float
    elevation: float
    windows: Float[np.ndarray, "n 3"]

    def height(self, model: mujoco.MjModel) -> float:
        """What the free camera shows at its distance, in m."""
        return float(2 * self.distance * np.tan(np.deg2rad(model.vis.global_.fovy) / 2))


def plane_camera(model: mujoco.MjModel) -> int:
    """The number of the camera called `plane`, or -1, which is MuJoCo's free camera."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, _CAMERA)


def window(model: mujoco.MjModel) -> Window:
    """That of the camera `plane`, where the model has one as above, else about what MuJoCo's free camera shows."""
    camera = _side_camera(model)
    x, _, z = model.stat.center if camera < 0 else model.cam_pos[camera]
    height = _FREE_CAMERA_HEIGHT * model.stat.extent if camera < 0 else model.cam_fovy[camera]
    return Window(float(x), float(z), float(height))


def aim(model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, "n nq"], aspect: float) -> Views:
    """Turns the model's camera to what moves, and follows it. `aspect` is width over height. `data` is moved.

    The view of the camera `plane` is widened until nothing that moves leaves it, nor a marker, but those that are far
    away. Without one the free camera is chosen, see `framing.follow`: targets are in its view where what moves is large
    enough beside them. MuJoCo's own default of the free camera becomes the first of the views.
    """
    moving, aims = _points(model, data, qpos)
    angles = direction(model, data)
    centre, distance = model.stat.center.copy(), _FREE_CAMERA_DISTANCE * model.stat.extent
    side = _side_camera(model)
    if side >= 0 and moving.size:
        _widen(model, side, moving, aspect)
    if plane_camera(model) >= 0 or not moving.size:
        centres, windows = (np.array([some] * len(qpos)) for some in (centre, window(model)))
        return Views(centres, distance, *angles, windows)
    axes = axes_of(*angles)
    fit = _follow(moving @ axes, aims @ axes, aspect, model.vis.global_.fovy)
    distance = float(((moving @ axes)[:, :, 2].mean(axis=1) - fit.place[:, 2]).mean())
    lookat = fit.place @ axes.T + distance * axes[:, 2]
    flat = _follow(moving[:, :, [0, 2, 1]], aims[:, :, [0, 2, 1]], aspect, None)  # Right is x, up is z.
    model.vis.global_.azimuth, model.vis.global_.elevation = angles
    model.stat.center[:], model.stat.extent = lookat[0], distance / _FREE_CAMERA_DISTANCE
    return Views(lookat, distance, *angles, np.column_stack([flat.place[:, :2], flat.height]))


def direction(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """Azimuth and elevation, in degrees: those of the file where it has any, else where its bodies are seen best."""
    given, usual = model.vis.global_, mujoco.MjSpec().visual.global_
    if (given.azimuth, given.elevation) != (usual.azimuth, usual.elevation):
        return float(given.azimuth), float(given.elevation)
    normal = _normal(model, data)
    if normal is None or _PARALLEL < abs(normal[2]) < 1 - _PARALLEL:
        return _OBLIQUE
    if abs(normal[2]) > 0.5:
        return float(usual.azimuth), _ABOVE
    right = np.array([normal[1], -normal[0]])  # Of who looks along the normal, and it shall be the axis that grows.
    forward = normal if right[np.abs(right).argmax()] > 0 else -normal
    return float(np.rad2deg(np.arctan2(forward[1], forward[0])) % 360), _SIDE


def _normal(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray | None:
    """Of the plane in which all bodies move, or None."""
    mujoco.mj_kinematics(model, data)
    kind, axes = model.jnt_type, data.xaxis
    turning, sliding = axes[kind == mujoco.mjtJoint.mjJNT_HINGE], axes[kind == mujoco.mjtJoint.mjJNT_SLIDE]
    if not model.njnt or len(turning) + len(sliding) < model.njnt:
        return None
    # Axes of slides may leave a choice: then y, else x, where they can be it.
    ways = [*turning[:1], np.array([0.0, 1, 0]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1])]
    for way in ways:
        if (np.abs(turning @ way) > 1 - _PARALLEL).all() and (np.abs(sliding @ way) < _PARALLEL).all():
            return way
    return None


def _follow(moving: np.ndarray, aims: np.ndarray, aspect: float, fovy: float | None) -> framing.Fit:
    """With the targets, where what moves is not small then."""
    if aims.size:
        both = framing.follow(np.concatenate([moving, aims], axis=1), aspect, fovy)
        alone = framing.filled(moving, both, aspect, fovy)
        if alone.min() >= framing.LEAST:
            return both
    return framing.follow(moving, aspect, fovy)


def _points(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, "n nq"]
) -> tuple[np.ndarray, np.ndarray]:
    """[n, k, 3] each: the corners of the boxes around all that moves and carries it, and those of targets."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    seen = np.array([planar.is_visible(model, i, _SEE_THROUGH) for i in range(model.ngeom)], bool)
    moves = moves & seen if (moves & seen).any() else moves
    moving, aims = _corners(model, data, qpos, np.flatnonzero(moves))
    carriers = np.flatnonzero(seen & np.isin(model.geom_bodyid, _carriers(model)))
    carrying, _ = _corners(model, data, qpos[:1], carriers)
    if carriers.size and moves.any() and _size(carrying) <= _size(moving):
        moving = np.concatenate([moving, np.broadcast_to(carrying, (len(qpos), *carrying.shape[1:]))], axis=1)
    return moving, aims


def _corners(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, "n nq"], geoms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    corners = model.geom_aabb[geoms][:, None, :3] + model.geom_aabb[geoms][:, None, 3:] * planar.CORNERS
    found, aims = [], []
    for position in qpos:
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        rotation = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
        found.append((data.geom_xpos[geoms, None] + (rotation @ corners[..., None])[..., 0]).reshape(-1, 3))
        aims.append(target_ends(model, data))
    return np.array(found), np.array(aims)


def _carriers(model: mujoco.MjModel) -> list[int]:
    """Bodies fixed to the world, but the world itself, on which others move."""
    parents = {int(model.body_parentid[body]) for body in np.flatnonzero(model.body_weldid)}
    found = set[int]()
    while parents := {body for body in parents if body and not model.body_weldid[body]}:
        found |= parents
        parents = {int(model.body_parentid[body]) for body in parents}
    return sorted(found)


def _size(points: Float[np.ndarray, "n k 3"]) -> float:
    """The diagonal of the box around them."""
    return float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0)))


def axes_of(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Right, up and forward, as columns, of MuJoCo's free camera."""
    a, e = np.deg2rad([azimuth, elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0])
    return np.stack([right, np.cross(right, forward), forward], axis=1)


def _widen(model: mujoco.MjModel, camera: int, moving: Float[np.ndarray, "n k 3"], aspect: float) -> None:
    x, z, height = window(model)
    seen = np.array([x, z]) + 0.5 * height * np.array([[-aspect, -1], [aspect, 1]])
    ends = moving[:, :, [0, 2]].reshape(-1, 2)
    points = [ends.min(axis=0), ends.max(axis=0), *_near_markers(model, Window(x, z, height), aspect)]
    seen = np.array([np.min([seen[0], *points], axis=0), np.max([seen[1], *points], axis=0)])
    model.cam_pos[camera, [0, 2]] = seen.mean(axis=0)
    model.cam_fovy[camera] = (np.ptp(seen, axis=0) / [aspect, 1]).max()


def _near_markers(model: mujoco.MjModel, shown: Window, aspect: float) -> list[np.ndarray]:
    """Ends (x, z) of the markers that a view twice as high and wide would show."""
    found = []
    for site in markers(model).values():
        place, radius = model.site_pos[site, [0, 2]], 2 * model.site_size[site].max()
        if (np.abs(place - shown[:2]) <= shown.height * np.array([aspect, 1])).all():
            found += [place - radius, place + radius]
    return found


def _side_camera(model: mujoco.MjModel) -> int:
    """The camera `plane` if it looks along y, orthographically, from a fixed place; or -1."""
    camera = plane_camera(model)
    if camera < 0 or model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC:
        return -1
    is_fixed = model.cam_bodyid[camera] == 0 and model.cam_mode[camera] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED
    sideways = np.abs(model.cam_mat0[camera] - [1, 0, 0, 0, 0, -1, 0, 1, 0]).max() < 1e-6
    return camera if is_fixed and sideways else -1
