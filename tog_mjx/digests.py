"""What a result was made with: a digest of the scene, and one of the program.

A result that was kept is read again only if both are the same.
"""

import functools
import hashlib
import importlib.metadata
from pathlib import Path

import mujoco
import numpy as np

from tog_mjx.tasks import Task

_DRAWS = ("figures", "report", "viewing")
"""Packages without influence on a result."""


def scene_digest(task: Task) -> str:
    """SHA-256 of the compiled scene: any change of a number in its MJCF file changes it."""
    model = task.scene.model
    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return hashlib.sha256(binary.tobytes()).hexdigest()


def made_with(task: Task) -> dict[str, str]:
    """Both digests, for the settings of a result that is kept."""
    return {"scene": scene_digest(task), "program": program_digest()}


@functools.cache
def program_digest() -> str:
    """SHA-256 of this package's code, without what only draws, and of the versions of the libraries that compute."""
    digest, package = hashlib.sha256(), Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] not in _DRAWS:
            digest.update(path.read_bytes())
    for library in ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy"):
        digest.update(f"{library}=={importlib.metadata.version(library)}".encode())
    return digest.hexdigest()
