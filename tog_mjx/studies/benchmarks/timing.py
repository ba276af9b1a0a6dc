"""Times, as medians of rounds in which every rival has its turn."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np


class Program(NamedTuple):
    """A compiled function of fixed arguments: to call; seconds to trace and compile; memory beside arguments, in MB."""

    run: Callable[[], Any]
    seconds_compile: float
    megabytes: float


def compiled(function: Callable, *arguments: Any) -> Program:
    """Compiles `function` for its arguments. The compilation cache must be off for the seconds to mean anything."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    memory = program.memory_analysis()
    return Program(lambda: program(*arguments), seconds, memory.temp_size_in_bytes / 1e6 if memory else float("nan"))


def interleaved(functions: Mapping[Any, Callable[[], Any]], repeats: int) -> dict[Any, float]:
    """Median seconds of each, one after the other in every round, so that a slow spell of the machine hits all.

    A round before the first, to warm up, does not count.
    """
    seconds: dict[Any, list[float]] = {name: [] for name in functions}
    for _ in range(repeats + 1):
        for name, function in functions.items():
            start = time.perf_counter()
            jax.block_until_ready(function())
            seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(found[1:])) for name, found in seconds.items()}
