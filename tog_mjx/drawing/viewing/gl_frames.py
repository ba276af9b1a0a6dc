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
        data.mocap_pos[:], data.mocap_quat[:] = states["mocap_pos"], states["mocap_quat"]
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    frames = np.empty((len(qpos), height, width, 3), np.uint8)
    with mujoco.Renderer(model, height, width) as renderer:
        for frame, position in zip(frames, qpos, strict=True):
            data.qpos[:] = position
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            renderer.render(out=frame)
    np.save(folder / "frames.npy", frames)


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # Where MuJoCo may leave its log.
    main(Path(sys.argv[1]))
