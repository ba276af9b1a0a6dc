"""Frames of a motion rendered by MuJoCo. A program of its own, started by `rendering.py` in a process of its own.

MuJoCo chooses its OpenGL backend once, when it is imported, and a broken driver can end the process: so it is tried in
another one. Its argument is a folder with `model.mjb` and `states.npz`; it adds `frames.npy`.
The camera -1 is the free one.
"""

import os
import sys
from pathlib import Path

import mujoco
import numpy as np

_TILES = 14
"""Tiles from the middle of a floor to where they fade."""
_SHADE = 0.84
"""Of every other tile."""
_SKY = np.array([0.86, 0.89, 0.93])


def main(folder: Path) -> None:
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "states.npz") as states:
        given = dict(states)
    camera, (width, height) = int(given["camera"]), given["size"].tolist()
    data.mocap_pos[:], data.mocap_quat[:] = given["mocap_pos"], given["mocap_quat"]
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    if given["is_dark"]:
        model.vis.map.shadowclip *= 5  # Else the floor at the side of the light has specks of shadow.
    frames = np.empty((len(given["qpos"]), height, width, 3), np.uint8)
    free = mujoco.MjvCamera()
    free.distance, free.azimuth, free.elevation = given["from"]
    with mujoco.Renderer(model, height, width) as renderer:
        for i, frame in enumerate(frames):
            data.qpos[:] = given["qpos"][i]
            mujoco.mj_forward(model, data)
            free.lookat[:] = given["lookat"][i]
            renderer.update_scene(data, free if camera < 0 else camera)
            scene = renderer.scene
            if given["is_dark"]:
                add_light(scene, free.lookat)
            if not given["has_sky"]:
                add_sky(scene, model, np.array(scene.camera[0].pos), scene.camera[0].forward)
            add_marks(scene, given["marks"], float(given["radius"]))
            for floor in given["floors"].tolist():
                add_tiles(scene, model, data, floor, free.lookat, float(given["tile"]))
            renderer.render(out=frame)
    np.save(folder / "frames.npy", frames)


def add_light(scene: mujoco.MjvScene, centre: np.ndarray) -> None:
    """From above, from the left and from the front, so that edges and shadows show, around a point."""
    light = scene.lights[scene.nlight]
    light.type, light.dir[:], light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, (0.4, 0.5, -0.77), 1
    light.pos[:] = centre
    light.ambient[:], light.diffuse[:], light.specular[:] = 0, 0.45, 0
    scene.nlight += 1


def add_sky(scene: mujoco.MjvScene, model: mujoco.MjModel, eye: np.ndarray, forward: np.ndarray) -> None:
    """A wall behind all that a camera sees, which shines."""
    far = 0.9 * model.vis.map.zfar * model.stat.extent
    turn, axes = np.zeros(4), np.zeros(9)
    mujoco.mju_quatZ2Vec(turn, np.array(forward, float))
    mujoco.mju_quat2Mat(axes, turn)
    dim = 0.01  # So that it shines alike in any light.
    size, place = far * np.array([4, 4, 0.004]), eye + far * np.array(forward)
    wall = _add(scene, mujoco.mjtGeom.mjGEOM_BOX, size, place, axes, [*dim * _SKY, 1])
    if wall:
        wall.emission = 1 / dim


def add_marks(scene: mujoco.MjvScene, places: np.ndarray, radius: float) -> None:
    """Balls where nothing else shows a target."""
    for place in places:
        _add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), place, np.eye(3), (0.0, 0.62, 0.45, 1))


def add_tiles(
    scene: mujoco.MjvScene,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    plane: int,
    centre: np.ndarray,
    side: float,
) -> None:
    """Every other tile of a plane, of this side in m, around the foot of a point; they fade far from it."""
    axes, origin = data.geom_xmat[plane].reshape(3, 3), data.geom_xpos[plane]
    foot = ((centre - origin) @ axes)[:2]
    limits = np.where(model.geom_size[plane, :2] > 0, model.geom_size[plane, :2], np.inf)
    first = np.floor(foot / side).astype(int) - _TILES
    for i in range(first[0], first[0] + 2 * _TILES + 1):
        for j in range(first[1], first[1] + 2 * _TILES + 1):
            low = np.maximum(side * np.array([i, j]), -limits)
            high = np.minimum(side * np.array([i + 1, j + 1]), limits)
            fade = 1 - np.sum(((low + high) / 2 - foot) ** 2) / (_TILES * side) ** 2
            if (i + j) % 2 or fade <= 0 or (high <= low).any():
                continue
            color = model.geom_rgba[plane] * [*[1 - (1 - _SHADE) * fade] * 3, 1]
            middle = origin + axes @ [*(low + high) / 2, 0]
            _add(scene, mujoco.mjtGeom.mjGEOM_BOX, np.array([*(high - low) / 2, 0.004 * side]), middle, axes, color)


def _add(scene: mujoco.MjvScene, kind, size, place, axes, color) -> mujoco.MjvGeom | None:
    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, place, axes.ravel(), np.array(color, np.float32))
    geom.specular = geom.reflectance = 0
    scene.ngeom += 1
    return geom


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # Where MuJoCo may leave its log.
    main(Path(sys.argv[1]))
