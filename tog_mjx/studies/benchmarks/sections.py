"""What is measured: one motion and its gradient, batches of them, and gradients as decision variables grow in number.

Each section returns rows, as JSON holds them; times of one section come from the same rounds.
"""

import dataclasses
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tog_mjx.engines import SIMULATORS, MjxSimulator, Simulator, make_simulator, reference
from tog_mjx.engines.objective import final_cost, objective
from tog_mjx.gradients import exact_batch, stochastic
from tog_mjx.problems import Problem
from tog_mjx.problems.library import get_problem
from tog_mjx.running.batches import chunk_size
from tog_mjx.running.console import CACHE_VARIABLE
from tog_mjx.running.devices import over_devices
from tog_mjx.studies.benchmarks.rivals import c_loop, python_loop
from tog_mjx.studies.benchmarks.timing import compiled, interleaved

Row = dict[str, Any]
Report = Callable[[str], None]

PYTHON = "Python loop, released"
UNROLLED = 20
"""Time steps of the Python loop, whose times are scaled to the whole horizon."""
PATIENT = 256
"""The largest batch of MJX on the cores of a CPU, and of C MuJoCo: more of them take as much longer."""
SIMULATED = ("penalty", "mjx")
"""In batches and crossovers."""
SIGMA = 0.1
"""Of the stochastic samples, whose time does not depend on it."""
PATIENCE = 5.0
"""Seconds: a gradient that takes longer is measured once, and its method left out from then on."""


def single(task: Problem, repeats: int, report: Report) -> list[Row]:
    """One motion and one gradient: `ms`, `evaluations` (of the same simulator's J), `seconds_compile`, `megabytes`."""
    u = jnp.array(task.x0)
    programs = {}
    for name, what, function in _single_rivals(task):
        report(f"{name}, {what}: compiling")
        programs[name, what] = compiled(function, u)
    steps = 1e-7 * np.concatenate([np.eye(u.size), -np.eye(u.size)]) + task.x0
    runs = {key: program.run for key, program in programs.items()}
    # As the paper's program ran: operation by operation, never compiled as a whole.
    loop = python_loop(task, make_simulator("released", task.scene), UNROLLED)
    runs[PYTHON, "J"] = functools.partial(loop, u)
    runs[PYTHON, "reverse mode"] = functools.partial(jax.grad(loop), u)
    one_thread, differences = ("C MuJoCo, 1 thread", "J"), ("C MuJoCo, all cores", "differences")
    runs[one_thread] = functools.partial(reference.final_costs, task, task.x0[None], 1)
    runs[differences] = functools.partial(reference.final_costs, task, steps)
    report("single: measuring")
    times = interleaved(runs, repeats)
    rows = []
    for (name, what), seconds in times.items():
        scale = (task.steps) / UNROLLED if name == PYTHON else 1.0
        program, alone = programs.get((name, what)), times.get((name, "J"), times[one_thread])
        rows.append(
            {
                "simulator": name,
                "what": what,
                "ms": 1e3 * seconds * scale,
                "evaluations": seconds / alone,
                "seconds_compile": program.seconds_compile if program else None,
                "megabytes": program.megabytes if program else None,
            }
        )
    return rows


def _single_rivals(task: Problem) -> list[tuple[str, str, Callable]]:
    """Name, what it computes, and the function of u."""
    found: list[tuple[str, str, Callable]] = []
    for name in ("penalty", "released", "mjx"):
        cost = functools.partial(final_cost, task, make_simulator(name, task.scene))
        found += [(name, "J", cost), (name, "forward mode", jax.jacfwd(cost)), (name, "reverse mode", jax.grad(cost))]
        if name in SIMULATED:
            engine = make_simulator(name, task.scene, differentiation="saltation")
            cost = functools.partial(final_cost, task, engine)
            found.append((name, "forward mode, saltation", jax.jacfwd(cost)))
            found.append((name, "reverse mode, saltation", jax.grad(cost)))
    stock = functools.partial(final_cost, task, one_iteration(make_simulator("mjx", task.scene)))
    found.append(("mjx, native, 1 iteration", "J", stock))
    found.append(("mjx, native, 1 iteration", "reverse mode", jax.grad(stock)))
    return found


def one_iteration(simulator: Simulator) -> MjxSimulator:
    """Stock MJX with solver and line search cut to one iteration: the only way in which it runs in reverse mode."""
    assert isinstance(simulator, MjxSimulator)
    option = simulator.model.opt.replace(iterations=1, ls_iterations=1)
    return dataclasses.replace(simulator, model=simulator.model.replace(opt=option), differentiation="native")


def start(task: Problem, report: Report) -> list[Row]:
    """Seconds from the start of a fresh process to its first gradient, by `exact`: without and with a filled cache."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for name in (*SIMULATED, "mujoco"):
            for what in ("compiled", "from the cache"):
                report(f"start: {name}, {what}")
                command = [sys.executable, "-m", "tog_mjx.studies.benchmarks.first_gradient", task.name, name]
                environment = {**os.environ, CACHE_VARIABLE: cache}
                began = time.perf_counter()
                said = subprocess.run(command, env=environment, capture_output=True, check=True)
                seconds = time.perf_counter() - began
                rows.append({"simulator": name, "what": what, "seconds": seconds, **json.loads(said.stdout)})
    return rows


def batches(task: Problem, sizes: Sequence[int], repeats: int, report: Report) -> list[Row]:
    """Motions and forward-mode gradients of many setpoints at once, on all devices: `per_second`, by batch size.

    The C loop is that of the flip, where there is a compiler.
    """
    is_cpu = jax.default_backend() == "cpu"
    points = np.random.default_rng(0).uniform(task.plane.low, task.plane.high, (max(sizes), 2))
    setpoints = np.asarray(task.plane.x(points))
    rows = []
    with c_loop(task) as loop:
        for size in sizes:
            report(f"batch of {size}")
            runs: dict[tuple[str, str], Callable] = {}
            for name in SIMULATED:
                if name == "mjx" and is_cpu and size > PATIENT:
                    continue
                cost = functools.partial(final_cost, task, make_simulator(name, task.scene))
                runs[name, "J"] = _in_chunks(jax.vmap(cost), setpoints[:size], name)
                runs[name, "gradient"] = _in_chunks(exact_batch(cost), setpoints[:size], name)
            if size <= PATIENT:
                in_c, some = objective(task, "mujoco"), jnp.asarray(setpoints[:size])
                runs["C MuJoCo, all cores", "J"] = functools.partial(jax.jit(jax.vmap(in_c)), some)
                runs["C MuJoCo, all cores", "gradient"] = functools.partial(jax.jit(jax.vmap(jax.grad(in_c))), some)
            if loop is not None:
                runs["C loop, all cores, float32", "J"] = functools.partial(loop, setpoints[:size])
            for (name, what), seconds in interleaved(runs, repeats).items():
                rows.append(
                    {"simulator": name, "what": what, "batch": size, "per_second": size / seconds, "seconds": seconds}
                )
    return rows


def _in_chunks(function: Callable, setpoints: np.ndarray, simulator: str) -> Callable[[], Any]:
    """As `batches.map_points` works, compiled beforehand."""
    run, size = over_devices(function), chunk_size(len(setpoints), SIMULATORS[simulator].CHUNK)
    firsts = range(0, len(setpoints), size)
    chunks = [np.resize(setpoints[first : first + size], (size, setpoints.shape[1])) for first in firsts]
    return lambda: [run(chunk) for chunk in chunks]


def crossover(task: Problem, knots: Sequence[int], repeats: int, report: Report) -> list[Row]:
    """One gradient, by method, against the number of decision variables: `ms`, `variables`."""
    rows = []
    for simulator in SIMULATED:
        tired: set[str] = set()
        for number in knots:
            report(f"{simulator}: {number} knots")
            runs = _gradients(get_problem(task, knots=number), simulator, tired)
            times = interleaved(runs, repeats) if runs else {}
            tired |= {method for method, seconds in times.items() if seconds > PATIENCE}
            for method, seconds in times.items():
                row = {"simulator": simulator, "method": method, "knots": number, "ms": 1e3 * seconds}
                rows.append({**row, "variables": number * task.x0.size})
    return rows


def _gradients(task: Problem, simulator: str, tired: set[str]) -> dict[str, Callable[[], Any]]:
    """By method, a gradient at the initial guess; those that are tired are left out."""
    u = jnp.array(task.x0)
    cost = functools.partial(final_cost, task, make_simulator(simulator, task.scene))
    sample = stochastic(cost, SIGMA)
    methods: dict[str, Callable] = {
        "J alone": cost,
        "reverse mode": jax.grad(cost),
        "forward mode": jax.jacfwd(cost),
        "one stochastic sample": lambda u: sample(jax.random.key(0), u),
    }
    if simulator == "mjx":
        methods["linear steps of C MuJoCo, all cores"] = jax.grad(objective(task, "mujoco"))
    runs = {name: compiled(method, u).run for name, method in methods.items() if name not in tired}
    if simulator == "mjx" and "differences of C MuJoCo, all cores" not in tired:
        steps = 1e-7 * np.concatenate([np.eye(u.size), -np.eye(u.size)]) + task.x0
        runs["differences of C MuJoCo, all cores"] = functools.partial(reference.final_costs, task, steps)
    return runs


def scaling(task: Problem, factors: Sequence[int], repeats: int, report: Report) -> list[Row]:
    """J and its reverse-mode gradient on `penalty`, as horizon, batch and knots grow: `ms`, `megabytes` by `factor`."""
    rows = []
    for what in ("horizon", "batch", "knots"):
        programs = {}
        for factor in factors:
            report(f"{what} times {factor}")
            grown = dataclasses.replace(task, steps=150 * factor) if what == "horizon" else task
            grown = get_problem(task, knots=8 * factor) if what == "knots" else grown
            u = jnp.array(grown.x0)
            cost = functools.partial(final_cost, grown, make_simulator("penalty", grown.scene))
            functions: dict[str, Callable] = {"J": cost, "reverse mode": jax.grad(cost)}
            if what == "batch":
                u, functions = jnp.tile(u, (64 * factor, 1)), {name: jax.vmap(f) for name, f in functions.items()}
            for name, function in functions.items():
                programs[name, factor] = compiled(function, u)
        times = interleaved({key: program.run for key, program in programs.items()}, repeats)
        for (name, factor), program in programs.items():
            row = {"grows": what, "factor": factor, "what": name, "ms": 1e3 * times[name, factor]}
            rows.append({**row, "megabytes": program.megabytes})
    return rows
