"""Rivals that are not this package's: a Python loop, and a plain C loop over SIMD lanes on all cores."""

import contextlib
import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from tog_mjx.engines import Simulator
from tog_mjx.engines.engine import on_plane
from tog_mjx.mjcf.contact import PenaltyLaw
from tog_mjx.problems import Problem
from tog_mjx.running.types import Scalar
from tog_mjx.stepping.mjx_state import START

_COMPILE = ("-O3", "-march=native", "-ffast-math", "-fopenmp", "-fPIC", "-c")
# Without -ffast-math: a library linked with it makes the processor flush subnormal numbers to zero, for everybody.
_LINK = ("-fopenmp", "-shared")


def python_loop(task: Problem, simulator: Simulator, steps: int) -> Callable[[jax.Array], Scalar]:
    """J after `steps` time steps, every step traced by Python: as the paper's released program unrolls its loop."""

    engine = on_plane(task, simulator)

    def cost(u: jax.Array) -> Scalar:
        carry = engine.begin(engine.model, {name: getattr(engine.origin, name) for name in START})
        for _ in range(steps):
            carry, _ = engine.step(engine.model, carry, u)
        return task.cost(engine.state(engine.model, carry, u))

    return cost


@contextlib.contextmanager
def c_loop(task: Problem):
    """A function from setpoints [N, 2] to costs [N] of the flip, in float32: the arithmetic of `penalty`, in C.

    Yields None where there is no C compiler. The library lives as long as the context.
    """
    compiler = shutil.which("cc")
    if compiler is None or task.name != "flip":
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        compiled, library = Path(folder) / "flips.o", Path(folder) / "flips.so"
        source = Path(__file__).with_name("flips.c")
        subprocess.run([compiler, *_COMPILE, str(source), "-o", str(compiled)], check=True)
        subprocess.run([compiler, *_LINK, str(compiled), "-o", str(library), "-lm"], check=True)
        array = np.ctypeslib.ndpointer(np.float32, flags="C")
        flips = ctypes.CDLL(str(library)).flips
        flips.argtypes = [array, ctypes.c_int, ctypes.c_int, array, array]
        parameters = _parameters(task)

        def run(setpoints: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
            given, costs = np.ascontiguousarray(setpoints, np.float32), np.empty(len(setpoints), np.float32)
            flips(given, len(given), task.steps, parameters, costs)
            return costs

        yield run


def _parameters(task: Problem) -> np.ndarray:
    """In the order of flips.c."""
    p = task.scene.physics
    numbers = [p.gravity, p.timestep, p.box_mass, p.box_inertia, *p.box_half, p.corner_radius]
    numbers += [p.finger_mass, p.finger_radius, p.finger_stiffness, p.finger_damping]
    for law in (p.corner_floor, p.finger_floor, p.finger_box):
        numbers += _law(law)
    box, fingers = task.scene.start
    return np.array([*numbers, *np.ravel(p.corners), *box, *fingers[0]], np.float32)


def _law(law: PenaltyLaw) -> list[float]:
    return [law.stiffness, law.damping, law.friction, law.viscosity]
