"""What of this machine can be found out only by trying, each in a process of its own: a driver that is broken ends it.

Here JAX is not imported: what is broken may be JAX.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

PATIENCE = 120
"""Seconds."""
_START = """
import json, os, sys
sys.path.append(sys.argv[1])
import jax
from tog_mjx import api
from tog_mjx.running.devices import use_all_cores
from tog_mjx.running.xla_flags import tune_compiler
use_all_cores()
tune_compiler()
assert jax.numpy.arange(3).sum() == 3
devices = [getattr(some, "device_kind", some.platform) for some in jax.devices()]
print(json.dumps({"devices": devices, "flags": os.environ.get("XLA_FLAGS", "")}))
"""
"""As a command starts."""
_RENDER = """
import sys, mujoco
scene = '<mujoco><worldbody><geom size="1" rgba="1 0 0 1"/></worldbody></mujoco>'
model = mujoco.MjModel.from_xml_string(scene)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 32, 32)
renderer.update_scene(data)
red, green, _ = renderer.render()[16, 16].tolist()
renderer.close()
if red <= 2 * green:
    sys.exit("what it renders is not the scene")
"""


class Tried(NamedTuple):
    """What a program printed, and its complaint in one line: empty where it neither failed nor warned."""

    said: str
    complaint: str
    failed: bool


def try_jax() -> Tried:
    """JSON: the kind of each of JAX's `devices`, and the `flags` of XLA, as they are when a command starts."""
    return _run(_START, {"MUJOCO_GL": "disable"})  # OpenGL is tried elsewhere.


def try_opengl(backend: str) -> Tried:
    """A small scene, rendered by MuJoCo with this backend."""
    # PyOpenGL's own choice, which MuJoCo makes elsewhere, would bind the other one to the same backend.
    return _run(_RENDER, {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": None})


def _run(program: str, changes: dict[str, str | None]) -> Tried:
    environment = {k: v for k, v in (os.environ | changes).items() if v is not None}
    command = [sys.executable, "-c", program, str(Path(__file__).parents[2])]
    with tempfile.TemporaryDirectory() as folder:  # Where MuJoCo may leave its log.
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            return Tried("", f"no answer within {PATIENCE} s", True)
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    if done.returncode:
        ended = f"ended by signal {-done.returncode}" if done.returncode < 0 else "failed"
        return Tried("", lines[-1] if lines and done.returncode > 0 else ended, True)
    return Tried(done.stdout, ": ".join(dict.fromkeys([*lines[:1], *lines[-1:]])), False)
