"""Policies in place of setpoints: exact gradients and an evolution strategy on the paper's two tasks, from many starts.

A policy of 2 x 32 tanh units sees box and fingers and sets the fingers' setpoints every 10 ms. A start is the scene's,
moved along the floor, the box raised and the fingers raised and drawn back from it, each by 5 cm (the standard
deviation): nothing overlaps. Both methods have the same evaluations of J on `penalty`; `closed_loop.csv` tells J and
success on 256 starts that neither has seen. With `--engine mjx`, of the flip's policy there: whether its gradient is
right, what it costs and needs, and a short training, in `closed_loop_mjx.csv`. Either takes some minutes on two cores.
With `--engine mjx --wide` both tasks are trained there, from 256 starts an update: for a GPU, in `closed_loop_gpu.csv`.
"""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import dataclasses
import functools
import importlib
import itertools
import time
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array, Float, Key

import tog_mjx as tog
from tog_mjx.engines.reference import STEPS
from tog_mjx.gradients.differences import settled_differences
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.console import run_main
from tog_mjx.running.types import AnyArray
from tog_mjx.stepping.mjx_state import default_start

HERE = Path(__file__).parent
UNITS, EVERY, SPREAD = 32, 10, 0.05
BUDGET, STARTS, HELD_OUT = 32_000, 32, 256
SUCCESS = {"flip": 0.1, "grasp": 0.2}
"""J below which a task counts as done, as in the other findings."""
PAIRS, SIGMA, STEP = 80, 0.05, 0.01
"""Of the evolution strategy, each of whose points has one start: antithetic pairs, their spread and Adam's step."""
SEEDS = range(8)
FEW, UPDATES, REACH, FEW_HELD_OUT = 8, 30, 0.2, 32
"""On MJX: starts of an update, updates, how far they go, and the starts that judge."""
WIDE, WIDE_UPDATES = 256, 225
"""The same for a GPU."""
LONG, SEGMENT, DIRECTIONS = 1000, 50, 8
"""Steps for which memory is measured, those between two checkpoints, and directions of differences."""


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=HERE, metavar="FOLDER")
    parser.add_argument("--engine", choices=["penalty", "mjx"], default="penalty")
    parser.add_argument("--wide", action="store_true", help="with --engine mjx: train both tasks on a GPU")
    args = parser.parse_args()
    if args.engine == "mjx" or args.wide:
        with jax.enable_x64():
            table = pd.DataFrame([trained(task) for task in SUCCESS] if args.wide else [on_mjx()])
        print(table.T.to_string(header=False))
        name = "closed_loop_gpu.csv" if args.wide else "closed_loop_mjx.csv"
        table.to_csv(args.out / name, index=False, float_format="%.3g")
        return
    rows = []
    with jax.enable_x64(False):
        for task, method in itertools.product(SUCCESS, METHODS):
            problem, guesses = closed_loop(task), jnp.stack([closed_loop(task, seed).x0 for seed in SEEDS])
            for seed, x in zip(SEEDS, METHODS[method](problem, guesses), strict=True):
                rows.append({"task": task, "method": method, "seed": seed, **judge(problem, x)})
            table = pd.DataFrame(rows)
            print(table.iloc[-len(SEEDS) :].to_string(index=False), flush=True)
            table.to_csv(args.out / "closed_loop.csv", index=False, float_format="%.4g")


def closed_loop(name: str, seed: int = 0, starts: int = STARTS) -> tog.Problem:
    """A task whose variables are a policy's weights."""
    task = get_task(name)
    fingers = task.scene.initial_guess.size

    def box(state: tog.State) -> Array:
        return jnp.concatenate([state.qpos[:3], state.qvel[:3]])

    def act(layers: list[dict[str, Array]], seen: Float[Array, " k"]) -> Float[Array, " nu"]:
        for layer in layers[:-1]:
            seen = jnp.tanh(seen @ layer["w"] + layer["b"])
        return jnp.asarray(task.initial_guess) + seen @ layers[-1]["w"] + layers[-1]["b"]

    here = default_start(task.scene.model).qpos
    is_x = np.isin(np.arange(len(here)), [0, *range(3, len(here), 2)])
    away = np.where(is_x, np.sign(here - here[0]), 1.0)  # The box itself, and its angle:
    away[[0, 2]] = 0

    def sample(key: Key[Array, ""]) -> dict[str, Array]:
        along, apart = SPREAD * jax.random.normal(key, (2, len(here)))
        return {"qpos": here + along[0] * is_x + away * jnp.abs(apart)}

    policy = tog.Policy(act, layers(seed, [2 * (3 + fingers), UNITS, UNITS, fingers]), every=EVERY)
    return tog.Problem(
        name,
        task.steps,
        policy,
        cost=task.cost,
        start=tog.Starts(sample, starts),
        success=SUCCESS[name],
    )


def layers(seed: int, sizes: list[int]) -> list[dict[str, np.ndarray]]:
    """Weights that keep the size of what goes through, the last ones a tenth of that."""
    rng, last = np.random.default_rng(seed), len(sizes) - 2
    return [
        {"w": rng.normal(size=(n, m)) / np.sqrt(n) * (0.1 if i == last else 1.0), "b": np.zeros(m)}
        for i, (n, m) in enumerate(itertools.pairwise(sizes))
    ]


def exact(problem: tog.Problem, guesses: Float[Array, "N n"]) -> list[AnyArray]:
    """The best policies of `tog.solve`, on held-out starts of its own."""
    return [tog.solve(problem, x, budget=BUDGET, engine="penalty").best for x in guesses]


def evolution_strategies(problem: tog.Problem, guesses: Float[Array, "N n"]) -> AnyArray:
    """The last means of OpenAI-ES."""
    keys = jax.vmap(jax.random.key)(jnp.asarray(SEEDS))
    return jax.jit(jax.vmap(functools.partial(evolution_strategy, problem)))(guesses, keys)


def evolution_strategy(problem: tog.Problem, x: Float[Array, " n"], key: Key[Array, ""]) -> Float[Array, " n"]:
    J, first = tog.objective(problem, "penalty"), jax.random.fold_in(key, 0)
    with jax.ensure_compile_time_eval():  # The import computes with JAX.
        algorithm = importlib.import_module("evosax.algorithms").Open_ES
    strategy = algorithm(2 * PAIRS, x, optimizer=optax.adam(STEP), std_schedule=optax.constant_schedule(SIGMA))
    settings = strategy.default_params

    def update(state, key: Key[Array, ""]):
        ask, tell, draw = jax.random.split(key, 3)
        points, state = strategy.ask(ask, state, settings)
        # Both points of a pair have the same start.
        keys = jnp.tile(jax.random.split(draw, PAIRS), 2)
        costs = jax.vmap(lambda x, key: J.each(x, key, 1)[0])(points, keys)
        return strategy.tell(tell, points, jnp.nan_to_num(costs, nan=1e9, posinf=1e9), state, settings)[0], None

    keys = jax.random.split(key, BUDGET // (2 * PAIRS))
    return strategy.get_mean(jax.lax.scan(update, strategy.init(first, x, settings), keys)[0])


METHODS: dict[str, Callable] = {"exact": exact, "OpenAI-ES": evolution_strategies}


def judge(problem: tog.Problem, x: AnyArray, engine: str = "penalty", starts: int = HELD_OUT) -> dict[str, float]:
    """J and success on starts that no training has drawn."""
    costs = np.asarray(tog.objective(problem, engine).each(x, jax.random.key(2**31), starts))
    return {"mean": costs.mean(), "median": np.median(costs), "success": (costs < problem.success).mean()}


def on_mjx() -> dict[str, float]:
    """What is true of the flip's policy on MJX, from its first weights."""
    problem = closed_loop("flip", starts=FEW)
    found = tog.solve(problem, budget=UPDATES * FEW * 4 / 0.9 + 1, reach=REACH, engine="mjx")
    return {
        **gradient_errors(problem),
        "reverse mode, evaluations": reverse_charge(problem),
        "of open loop": reverse_charge(tog.Problem("flip", problem.steps, cost=problem.cost, start=problem.start)),
        f"MB of reverse mode, {LONG} steps": megabytes(problem, None),
        f"MB, {SEGMENT} steps a checkpoint": megabytes(problem, SEGMENT),
        "gradients": len(found.costs),
        "J before": judge(problem, problem.x0, "mjx", FEW_HELD_OUT)["mean"],
        "J after": (after := judge(problem, found.best, "mjx", FEW_HELD_OUT))["mean"],
        "success after": after["success"],
    }


def trained(name: str) -> dict[str, Any]:
    """A policy trained on MJX from many starts at a time, as `tog.solve` does it."""
    problem = closed_loop(name, starts=WIDE)
    found = tog.solve(problem, budget=WIDE_UPDATES * WIDE * 4 / 0.9 + 1, engine="mjx")
    which = {"task": name, "device": jax.devices()[0].device_kind, "gradients": len(found.costs)}
    seconds = {"seconds, compile": found.seconds_compile, "seconds, run": found.seconds_run}
    return {**which, **judge(problem, found.best, "mjx"), **seconds}


def gradient_errors(problem: tog.Problem) -> dict[str, float]:
    """Relative, of slopes along random directions, from one start: reverse mode against the two others."""
    J, x, key = tog.objective(problem, "mjx"), jnp.asarray(problem.x0), jax.random.key(1)
    along = np.linalg.qr(np.random.default_rng(0).normal(size=(x.size, DIRECTIONS)))[0]

    def cost(t: Float[Array, " k"]) -> Array:
        return J.each(x + along @ t, key, 1)[0]

    none, values = np.zeros(DIRECTIONS), jax.jit(jax.vmap(cost))
    reverse = np.asarray(jax.jit(jax.grad(lambda x: J.each(x, key, 1)[0]))(x)) @ along
    forward = np.asarray(jax.jit(jax.jacfwd(cost))(none))
    differences = settled_differences(lambda t: np.asarray(values(t))[:, None], none[None], STEPS)

    def apart(other: np.ndarray) -> float:
        return float(np.linalg.norm(reverse - other) / np.linalg.norm(other))

    return {"error against differences": apart(differences.jacobian[0, 0]), "forward against reverse": apart(forward)}


def reverse_charge(problem: tog.Problem) -> float:
    """Evaluations of J that a gradient takes in reverse mode, by the shortest of five runs each."""
    J, x, seconds = tog.objective(problem, "mjx"), jnp.asarray(problem.x0), []
    for function in (J, jax.grad(J)):
        program, runs = jax.jit(function).lower(x).compile(), []
        for _ in range(5):
            begin = time.perf_counter()
            jax.block_until_ready(program(x))
            runs.append(time.perf_counter() - begin)
        seconds.append(min(runs))
    return seconds[1] / seconds[0]


def megabytes(problem: tog.Problem, checkpoint: int | None) -> float:
    """What a gradient in reverse mode needs beside its arguments, over LONG steps from each start."""
    longer = dataclasses.replace(problem, steps=LONG)
    gradient = jax.grad(tog.objective(longer, "mjx", checkpoint=checkpoint))
    needs: Any = jax.jit(gradient).lower(jnp.asarray(problem.x0)).compile().memory_analysis()
    return needs.temp_size_in_bytes / 1e6


if __name__ == "__main__":
    run_main(main)
