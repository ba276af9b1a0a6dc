"""The gradient of a motion of anybody's model on both engines: what a time step costs, and how far they are apart."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from mujoco import MjModel

from tog_mjx.engines import objective
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.engine import OnMujoco, make_engine
from tog_mjx.engines.objective import final_cost
from tog_mjx.gradients.differences import halvings, settled_differences
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.mjcf.supported import check_supported
from tog_mjx.problems import Problem
from tog_mjx.problems.state import State
from tog_mjx.problems.variables import Controls
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Scalar
from tog_mjx.stepping.converged import converged
from tog_mjx.studies.benchmarks.timing import compiled, interleaved

Point: TypeAlias = Float[np.ndarray, " n"]
STEPS, DIRECTIONS = 100, 6
SHARE = 0.3
"""Of the range of the controls, about whose middle they are drawn."""
HALVINGS = halvings(1e-4, 9)
MJX, ONE, ALL = "mjx", "C MuJoCo, 1 thread", "C MuJoCo, all cores"


def all_controls(path: Path, prepare: Callable[[MjModel], MjModel] = lambda model: model) -> tuple[Problem, Point]:
    """All controls of STEPS time steps of a model, and random ones: J is a random sum of where the motion ends."""
    model, random = prepare(compile_model(path)), np.random.default_rng(0)
    weights, speeds = random.normal(size=model.nq), 0.1 * random.normal(size=model.nv)

    def cost(last: State) -> Scalar:
        return weights @ last.qpos + speeds @ last.qvel

    problem = Problem(model, STEPS, Controls(STEPS, hold=True), cost=cost)
    low, high = problem.limits
    middle = np.where(np.isfinite(low + high), (low + high) / 2, problem.x0)  # At a limit J has a kink.
    return problem, middle + SHARE * problem.bound.scale * random.uniform(-1, 1, problem.x0.shape)


def engines(paths: Sequence[Path], repeats: int, report: Callable[[str], None]) -> list[dict[str, Any]]:
    """One gradient in reverse mode: `us_per_step`, the same `of_mjx`, and the `seconds_compile`.

    `apart` is how far, relative to its norm, that of C MuJoCo is from MJX's; of a model that MJX refuses from
    differences of whole motions along random directions, and `settled` by how much those change at the last halving.
    In these motions the solver comes to its answer, as in a derivative: where it stops short by an iteration its answer
    hangs on where it began.
    """
    rows = []
    for path in paths:
        problem, x = all_controls(path)
        gradients = {name: jax.grad(cost) for name, cost in _costs(problem).items()}
        programs = {}
        for name, gradient in gradients.items():
            report(f"{path.stem}, {name}: compiling")
            programs[name] = compiled(gradient, jnp.asarray(x))
        found = {name: np.asarray(program.run()) for name, program in programs.items()}
        report(f"{path.stem}: measuring")
        times = interleaved({name: program.run for name, program in programs.items()}, repeats)
        apart, settled = _apart(path, x, found)
        for name, seconds in times.items():
            rows.append(
                {
                    "model": path.stem,
                    "nv": problem.scene.model.nv,
                    "engine": name,
                    "us_per_step": 1e6 * seconds / STEPS,
                    "of_mjx": seconds / times[MJX] if MJX in times else None,
                    "seconds_compile": programs[name].seconds_compile,
                    "apart": None if name == MJX else apart,
                    "settled": None if name == MJX else settled,
                }
            )
    return rows


def _costs(problem: Problem) -> dict[str, Callable[[Array], Scalar]]:
    engine = make_engine(problem, "mujoco")
    assert isinstance(engine, OnMujoco)
    alone = dataclasses.replace(engine, forward=Forward(problem.scene.model, problem.origin, threads=1))
    found: dict[str, Callable[[Array], Scalar]] = {
        ONE: functools.partial(final_cost, problem, alone),
        ALL: objective(problem, "mujoco"),
    }
    try:
        check_supported(problem.scene.model, problem.scene.name)
    except InputError:
        return found
    return {MJX: objective(problem, "mjx"), **found}


def _apart(path: Path, x: Point, found: dict[str, np.ndarray]) -> tuple[float, float | None]:
    gradient = found[ALL]
    if MJX in found:
        expected, settled = found[MJX], None
    else:
        directions = np.random.default_rng(1).normal(size=(DIRECTIONS, x.size)) / np.sqrt(x.size)
        J = objective(all_controls(path, converged)[0], "mujoco")
        values = jax.jit(jax.vmap(lambda a: J(x + a @ directions)))
        differences = settled_differences(
            lambda points: np.asarray(values(jnp.asarray(points)))[:, None], np.zeros((1, DIRECTIONS)), HALVINGS
        )
        gradient, expected, settled = directions @ gradient, differences.jacobian[0, 0], float(differences.change[0])
    return float(np.linalg.norm(gradient - expected) / np.linalg.norm(expected)), settled
