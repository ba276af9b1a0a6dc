"""What a frame shows: the view of a scene's camera, of all that moves, in a light that shows it."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.viewing.shown import markers

_CAMERA = "plane"
"""Looks along y, orthographically."""
_FREE_CAMERA_HEIGHT = 1.25
"""In extents of the model: what MuJoCo's free camera shows at the centre."""
_FREE_CAMERA_SPHERE = 1.14
"""In extents of the model: the diameter of a sphere that MuJoCo's free camera shows whole."""
_GREY = (0.5, 0.5, 0.5, 1)
"""The colour of a geom whose file gives none."""
_COLORS = ((0.35, 0.55, 0.8, 1), (0.9, 0.6, 0.3, 1), (0.4, 0.7, 0.5, 1), (0.8, 0.5, 0.65, 1))


class Window(NamedTuple):
    """The centre (x, z) and the height of a view along y, in m."""

    x: float
    z: float
    height: float


def plane_camera(model: mujoco.MjModel) -> int:
    """The number of the camera called `plane`, or -1, which is MuJoCo's free camera."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, _CAMERA)


def window(model: mujoco.MjModel) -> Window:
    """That of the camera `plane`, where the model has one as above, else about what MuJoCo's free camera shows."""
    camera = _side_camera(model)
    x, _, z = model.stat.center if camera < 0 else model.cam_pos[camera]
    height = _FREE_CAMERA_HEIGHT * model.stat.extent if camera < 0 else model.cam_fovy[camera]
    return Window(float(x), float(z), float(height))


def aim(model: mujoco.MjModel, data: mujoco.MjData, qpos: Float[np.ndarray, "n nq"], aspect: float) -> None:
    """Turns the model's camera to what moves. `aspect` is width over height.

    The view of the camera `plane` is widened until nothing that moves leaves it, nor a marker, but those that are far
    away. The free camera is set so that it shows what moves, and little else.
    """
    moving = model.body_weldid[model.geom_bodyid] != 0
    if not moving.any():
        return
    low, high = [], []
    centre, half = model.geom_aabb[moving, :3, None], model.geom_aabb[moving, 3:, None]
    for position in qpos:
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        rotation = data.geom_xmat[moving].reshape(-1, 3, 3)
        middle = data.geom_xpos[moving] + (rotation @ centre)[:, :, 0]
        reach = (np.abs(rotation) @ half)[:, :, 0]
        low.append((middle - reach).min(axis=0))
        high.append((middle + reach).max(axis=0))
    ends = np.array([np.min(low, axis=0), np.max(high, axis=0)])
    camera = _side_camera(model)
    if camera >= 0:
        x, z, height = window(model)
        seen = np.array([x, z]) + 0.5 * height * np.array([[-aspect, -1], [aspect, 1]])
        points = [*ends[:, [0, 2]], *_near_markers(model, height, aspect)]
        seen = np.array([np.min([seen[0], *points], axis=0), np.max([seen[1], *points], axis=0)])
        model.cam_pos[camera, [0, 2]] = seen.mean(axis=0)
        model.cam_fovy[camera] = (np.ptp(seen, axis=0) / [aspect, 1]).max()
    elif plane_camera(model) < 0:
        model.stat.center[:] = ends.mean(axis=0)
        model.stat.extent = np.linalg.norm(np.ptp(ends, axis=0)) / _FREE_CAMERA_SPHERE / min(1, aspect)


def light(model: mujoco.MjModel) -> bool:
    """Brightens a model whose file has no light, and gives each body that moves a colour where it has MuJoCo's grey.

    Returns whether there was no light; else nothing is changed.
    """
    given, usual = model.vis.headlight, mujoco.MjSpec().visual.headlight
    if model.nlight or (given.ambient != usual.ambient).any() or (given.diffuse != usual.diffuse).any():
        return False
    given.ambient[:], given.diffuse[:], given.specular[:] = 0.35, 0.35, 0
    for geom, body in enumerate(model.geom_bodyid):
        is_grey = model.geom_matid[geom] < 0 and (model.geom_rgba[geom] == _GREY).all()
        if is_grey and model.body_weldid[body]:
            model.geom_rgba[geom] = _COLORS[body % len(_COLORS)]
    return True


def _near_markers(model: mujoco.MjModel, height: float, aspect: float) -> list[np.ndarray]:
    """Ends (x, z) of the markers that a view twice as high and wide would show."""
    centre, found = np.array(window(model)[:2]), []
    for site in markers(model).values():
        place, radius = model.site_pos[site, [0, 2]], 2 * model.site_size[site].max()
        if (np.abs(place - centre) <= height * np.array([aspect, 1])).all():
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
