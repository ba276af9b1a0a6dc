"""MJX, imported quietly, and only in a version that this package has been checked against.

MJX prints to standard output on import (that the optional Warp is not installed); a program's standard output is its
own. And `tog_mjx.constraints` reads fields that MJX keeps private, which another version may rename or redefine.
"""

import contextlib
import importlib.metadata
import io

import jax
import mujoco

OLDEST, NEXT = (3, 17), (4, 0)


def check_version(version: str) -> None:
    """Raises ImportError, with the remedy, for a version of mujoco-mjx outside [OLDEST, NEXT)."""
    if not OLDEST <= tuple(int(part) for part in version.split(".")[:2]) < NEXT:
        wanted = f">={'.'.join(map(str, OLDEST))},<{'.'.join(map(str, NEXT))}"
        raise ImportError(
            f"mujoco-mjx {version} is installed, tog_mjx needs {wanted}: pip install 'mujoco-mjx{wanted}'"
        )


check_version(importlib.metadata.version("mujoco-mjx"))
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx as mjx
    from mujoco.mjx._src.collision_driver import geom_pairs as geom_pairs
    from mujoco.mjx._src.collision_driver import has_collision_fn as has_collision_fn


def put_model(model: mujoco.MjModel) -> mjx.Model:
    """The model on MJX's JAX implementation, on a device of this process: MJX's own choice may lie in another one."""
    return mjx.put_model(model, device=jax.local_devices()[0], impl="jax")


def make_data(model: mujoco.MjModel | mjx.Model) -> mjx.Data:
    """As `put_model`."""
    return mjx.make_data(model, device=jax.local_devices()[0])
