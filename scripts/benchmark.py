"""What a gradient costs: times as ratios of the same run, on one task.

Rivals: one evaluation of J; stock MJX in reverse mode with its solver cut to one iteration, the only way in which stock
reverse mode runs at all; and central differences of C MuJoCo, with one step size.
"""

import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx import reference
from tog_mjx.console import ArgumentParser, run_main
from tog_mjx.rollout import final_cost
from tog_mjx.simulators import MjxSimulator, make_simulator
from tog_mjx.tasks import TASKS, Task, get_task

BATCH = 32


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=list(TASKS), default="flip")
    parser.add_argument(
        "--repeats", type=int, default=15, metavar="N", help="of which the median is taken (default: 15)"
    )
    args = parser.parse_args()
    if args.repeats < 1:
        parser.error(f"argument --repeats: {args.repeats} is too few; give 1 or more")
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)  # Compilation is measured too.
    task = get_task(args.task)
    table = Table(box=box.MARKDOWN)
    for column in (
        f"{task.name}, {task.initial_guess.size} variables",
        "compile s",
        "ms",
        "evaluations",
        "MB",
        "ms each of 32",
    ):
        table.add_column(column, justify="left" if column.startswith(task.name) else "right", no_wrap=True)
    for row in measure(task, args.repeats):
        table.add_row(*row)
    Console(width=120, highlight=False).print(table)


def one_iteration(simulator: MjxSimulator) -> MjxSimulator:
    """Stock MJX with solver and line search cut to one iteration."""
    option = simulator.model.opt.replace(iterations=1, ls_iterations=1)
    return dataclasses.replace(simulator, model=simulator.model.replace(opt=option), differentiation="native")


def measure(task: Task, repeats: int) -> list[tuple[str, ...]]:
    simulator = make_simulator("mjx", task.scene)
    assert isinstance(simulator, MjxSimulator)
    stock = one_iteration(simulator)

    def cost(u: jax.Array) -> Any:
        return final_cost(task, simulator, u)

    functions: dict[str, Callable] = {
        "J": cost,
        "forward mode": jax.jacfwd(cost),
        "reverse mode": jax.grad(cost),
        "stock reverse mode, 1 iteration": jax.grad(lambda u: final_cost(task, stock, u)),
    }
    u = jnp.array(task.initial_guess)
    us = u + jnp.linspace(0, 0.1, BATCH)[:, None]
    rows, single, batched = {}, {}, {}
    for name, function in functions.items():
        start = time.perf_counter()
        single[name] = jax.jit(function).lower(u).compile()
        seconds = time.perf_counter() - start
        memory = single[name].memory_analysis()
        rows[name] = f"{seconds:.1f}", f"{memory.temp_size_in_bytes / 1e6:.2f}" if memory else "-"
        batched[name] = jax.jit(jax.vmap(function)).lower(us).compile()
    steps = 1e-7 * np.concatenate([np.eye(u.size), -np.eye(u.size)]) + task.initial_guess
    times = interleaved({name: lambda f=f: f(u) for name, f in single.items()}, repeats)
    many = interleaved({name: lambda f=f: f(us) for name, f in batched.items()}, max(3, repeats // 5))
    c = interleaved({"c": lambda: reference.final_costs(task, steps)}, repeats)["c"]
    found: list[tuple[str, ...]] = []
    for name, (compiled, memory) in rows.items():
        ratio = f"{times[name] / times['J']:.2f}"
        found.append((name, compiled, f"{1e3 * times[name]:.1f}", ratio, memory, f"{1e3 * many[name] / BATCH:.2f}"))
    found.append(
        (f"C MuJoCo, differences, {os.cpu_count()} cores", "-", f"{1e3 * c:.1f}", f"{c / times['J']:.2f}", "-", "-")
    )
    return found


def interleaved(functions: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Median seconds of each, one after the other in every round, so that a slow spell of the machine hits all."""
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            jax.block_until_ready(function())
            seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(found)) for name, found in seconds.items()}


if __name__ == "__main__":
    run_main(main)
