"""What a gradient costs: compilation, time and memory of each way to it, and which to take."""

import contextlib
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from tog_mjx.checks.measured.linearised import Linearised
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.gradients.reversible import unless_refused
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.mjx_state import copy_of


def cost(simulation: Simulation) -> Finding:
    """Forward mode, reverse mode, and linear steps and differences of C MuJoCo, for the derivative of one output in all
    variables."""
    n = len(simulation.directions)
    x = jnp.zeros(n)
    ways: dict[str, Callable] = {
        "value": lambda x: simulation.value(x)[0],
        "forward mode": jax.jacfwd(lambda x: simulation.value(x)[0]),
        "reverse mode": jax.grad(lambda x: simulation.value(x)[0]),
    }
    with contextlib.suppress(InputError):  # What C MuJoCo cannot is no rival.
        on_c = Linearised(simulation.scene, simulation.directions)
        ways["reverse mode through C MuJoCo"] = jax.grad(lambda x: on_c.value(x)[0])
    rows = [_measure(name, way, x) for name, way in ways.items() if name != "forward mode" or n <= 64]
    seconds = 2 * n * _seconds_of_c(simulation)
    rows.append({"way": "central differences of C MuJoCo", "compile s": 0.0, "run s": seconds, "MB": 0.0})
    gradients = [row for row in rows if row["way"] != "value" and np.isfinite(row["run s"])]
    best = min(gradients, key=lambda row: row["run s"])
    told = "; ".join(
        f"{row['way']} {1e3 * row['run s']:.3g} ms, compiled in {row['compile s']:.0f} s, {row['MB']:.3g} MB"
        for row in rows
        if np.isfinite(row["run s"])
    )
    sentence = f"for {n} variable{'s' * (n > 1)} {best['way']} is the fastest gradient ({told})"
    curves = {f"{row['way']}: compile s, run s, MB": [row[key] for key in ("compile s", "run s", "MB")] for row in rows}
    return Finding("cost", Level.FINE, sentence, best["run s"], "", curves)


def _measure(name: str, function: Callable, x: jax.Array) -> dict[str, Any]:
    """Seconds to compile, of the shortest of three runs, and the memory that the program needs beside its arguments."""
    begin = time.perf_counter()
    program = unless_refused(lambda: jax.jit(function).lower(x).compile())
    if program is None:
        return dict.fromkeys(("compile s", "run s", "MB"), np.nan) | {"way": name}
    compiled = time.perf_counter() - begin
    runs = [seconds_of(lambda: jax.block_until_ready(program(x))) for _ in range(3)]
    memory = program.memory_analysis()
    megabytes = memory.temp_size_in_bytes / 1e6 if memory else np.nan
    return {"way": name, "compile s": compiled, "run s": min(runs), "MB": megabytes}


def _seconds_of_c(simulation: Simulation) -> float:
    """Of one motion of C MuJoCo on one core."""
    scene = simulation.scene
    starts = [copy_of(scene.model, scene.start) for _ in range(2)]
    return min(seconds_of(mujoco.mj_step, scene.model, data, scene.steps) for data in starts)


def seconds_of(run: Callable, *args: Any) -> float:
    begin = time.perf_counter()
    run(*args)
    return time.perf_counter() - begin
