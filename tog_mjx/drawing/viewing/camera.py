"""What a frame shows: the view of a scene's camera, wide enough for the motion."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.viewing.shown import markers

_CAMERA = "plane"
"""Looks along y, orthographically."""
_FREE_CAMERA_HEIGHT = 1.25
"""In extents of the model: what MuJoCo's free camera shows at the centre."""


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
    """Widens the view of the model's camera until nothing that moves leaves it. `aspect` is width over height.

    The camera `plane` shows the markers too, but those that are far away.
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
    elif plane_camera(model) < 0 and np.abs(ends - model.stat.center).max() > model.stat.extent:
        model.stat.center[:] = ends.mean(axis=0)
        model.stat.extent = np.ptp(ends, axis=0).max()


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
