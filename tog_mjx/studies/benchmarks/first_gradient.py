"""A process of its own up to its first gradient, as a script starts: `first_gradient TASK SIMULATOR`.

Prints, as JSON, the seconds to trace and to compile (or to load what the cache has). What is left of the process's time
goes to imports, the scene and one run.
"""

import json
import sys
import time

import jax
import jax.numpy as jnp

from tog_mjx.engines.objective import objective
from tog_mjx.gradients import exact
from tog_mjx.problems.library import get_problem
from tog_mjx.running.console import run_main


def main() -> None:
    task, simulator = get_problem(sys.argv[1]), sys.argv[2]
    with jax.enable_x64():
        arguments = jax.random.key(0), jnp.array(task.x0)
        laps = [time.perf_counter()]
        traced = jax.jit(exact(objective(task, simulator))).trace(*arguments)
        laps.append(time.perf_counter())
        compiled = traced.lower().compile()
        laps.append(time.perf_counter())
        jax.block_until_ready(compiled(*arguments))
    print(json.dumps({"seconds_trace": laps[1] - laps[0], "seconds_compile": laps[2] - laps[1]}))


if __name__ == "__main__":
    run_main(main)
