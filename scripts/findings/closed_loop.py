"""Policies in place of setpoints: exact gradients and an evolution strategy on the paper's two tasks, from many starts.

A policy of 2 x 32 tanh units sees box and fingers and sets the fingers' setpoints every 10 ms. A start is the scene's,
moved along the floor, the box raised and the fingers raised and drawn back from it, each by 5 cm (the standard
deviation): nothing overlaps. Both methods have the same evaluations of J on
`penalty`; `closed_loop.csv` tells J and success on 256 starts that neither has seen. Takes some minutes on two cores.
"""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import functools
import importlib
import itertools
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array, Float, Key

import tog_mjx as tog
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.console import run_main
from tog_mjx.running.types import AnyArray
from tog_mjx.solving.solve import CHARGE
from tog_mjx.stepping.mjx_state import default_start

HERE = Path(__file__).parent
UNITS, EVERY, SPREAD = 32, 10, 0.05
BUDGET, STARTS, HELD_OUT = 32_000, 32, 256
SUCCESS = {"flip": 0.1, "grasp": 0.2}
"""J below which a task counts as done, as in the other findings."""
PAIRS, SIGMA, STEP = 80, 0.05, 0.01
"""Of the evolution strategy, each of whose points has one start: antithetic pairs, their spread and Adam's step."""
RATE = 5e-3
"""Of the exact gradients' first step; it falls to nothing as a cosine does."""
SEEDS = range(8)


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=HERE, metavar="FOLDER")
    args = parser.parse_args()
    rows = []
    with jax.enable_x64(False):
        for task, method in itertools.product(SUCCESS, METHODS):
            problem = closed_loop(task)
            guesses = jnp.stack([jnp.asarray(closed_loop(task, seed).x0) for seed in SEEDS])
            keys = jax.vmap(jax.random.key)(jnp.asarray(SEEDS))
            trained = jax.jit(jax.vmap(functools.partial(METHODS[method], problem)))(guesses, keys)
            for seed, x in zip(SEEDS, trained, strict=True):
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


def exact(problem: tog.Problem, x: Float[Array, " n"], key: Key[Array, ""]) -> Float[Array, " n"]:
    """The last policy of Adam, by gradients whose length is bounded: one start may touch where others do not."""
    J, updates = tog.objective(problem, "penalty"), int(BUDGET / (STARTS * CHARGE))
    schedule = optax.cosine_decay_schedule(RATE, updates)
    rule = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule, b2=0.95))

    def update(now, key: Key[Array, ""]):
        x, memory = now
        step, memory = rule.update(jax.grad(J)(x, key), memory, x)
        return (optax.apply_updates(x, step), memory), None

    return jax.lax.scan(update, (x, rule.init(x)), jax.random.split(key, updates))[0][0]


def evolution_strategy(problem: tog.Problem, x: Float[Array, " n"], key: Key[Array, ""]) -> Float[Array, " n"]:
    """The last mean of OpenAI-ES."""
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


METHODS: dict[str, Callable[..., Array]] = {"exact": exact, "OpenAI-ES": evolution_strategy}


def judge(problem: tog.Problem, x: AnyArray) -> dict[str, float]:
    """J and success on starts that no training has drawn."""
    costs = np.asarray(tog.objective(problem, "penalty").each(x, jax.random.key(2**31), HELD_OUT))
    return {"mean": costs.mean(), "median": np.median(costs), "success": (costs < problem.success).mean()}


if __name__ == "__main__":
    run_main(main)
