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


def main(folder: Path) -> None:
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "states.npz") as states:
        qpos, camera, (width, height) = states["qpos"], int(states["camera"]), states["size"].tolist()
        is_dark = bool(states["is_dark"])
        data.mocap_pos[:], data.mocap_quat[:] = states["mocap_pos"], states["mocap_quat"]
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    frames = np.empty((len(qpos), height, width, 3), np.uint8)
    with mujoco.Renderer(model, height, width) as renderer:
        for frame, position in zip(frames, qpos, strict=True):
            data.qpos[:] = position
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            if is_dark:
                add_light(renderer.scene)
            renderer.render(out=frame)
    np.save(folder / "frames.npy", frames)


def add_light(scene: mujoco.MjvScene) -> None:
    """From above, from the left and from the front, so that edges and shadows show."""
    light = scene.lights[scene.nlight]
    light.type, light.dir[:], light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, (0.4, 0.5, -0.77), 1
    light.ambient[:], light.diffuse[:], light.specular[:] = 0, 0.45, 0
    scene.nlight += 1


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # Where MuJoCo may leave its log.
    main(Path(sys.argv[1]))
