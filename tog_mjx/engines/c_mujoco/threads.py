"""Work on many members, on all cores; an interruption ends all of it."""

import functools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.running.devices import cores
from tog_mjx.running.interruption import has_come

SIGNALS = 0.1
"""Seconds after which Python, waiting for threads, looks for one that came just before it began to wait."""


@functools.cache
def pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), "linearise")


def for_each(forward: Forward, held: Float[np.ndarray, "N h"], one: Callable[[mujoco.MjData, int], None]) -> None:
    """`one(data, number)` of so many members, on all cores, whose data and their model have what each holds; unless the
    program is interrupted."""

    is_same = bool((held == held[:1]).all())

    def some(numbers: Iterable[int]) -> None:
        before = None
        with forward.data() as data:
            for i in numbers:
                if before is None or (not is_same and (held[i] != held[before]).any()):
                    forward.hold(data, held[i])
                one(data, i)
                before = i

    on_all_cores(forward, some, len(held))


def on_all_cores(forward: Forward, some: Callable[[Iterable[int]], None], count: int) -> None:
    """Calls a function of some of the numbers below `count` until all have been given, each once."""
    interrupted = False

    def going_on(numbers: np.ndarray) -> Iterator[int]:
        for i in numbers.tolist():
            if interrupted or has_come():
                return
            yield i

    # Each a comb, not a piece: where a motion is in contact its steps take longer.
    parts = [np.arange(first, count, forward.threads) for first in range(min(count, forward.threads))]
    try:
        if len(parts) == 1:
            some(going_on(parts[0]))
            parts = []
        running = {pool().submit(some, going_on(part)) for part in parts}
        while running:
            done, running = wait(running, SIGNALS)
            for future in done:
                future.result()
    except BaseException:
        interrupted = True
        raise
    if has_come():
        raise KeyboardInterrupt
