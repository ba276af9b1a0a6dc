"""A function of many points: compiled once for chunks of one size, on all devices, and kept on disk as it goes."""

import contextlib
import operator
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.running.devices import agree, is_first_process, over_devices
from tog_mjx.running.digests import function_digest, lowered
from tog_mjx.running.storage import DamagedFileError, load_result, of_shapes, save_result

CHUNK = 64
"""Points computed at a time on each core, unless told otherwise."""
ON_GPU = 256
"""So many times more on a GPU: its time for a step hardly grows until some 10,000 motions of MJX share it."""
_SECONDS_BETWEEN_WRITES = 10


def map_points(
    function: Callable,
    points: Float[np.ndarray, "N n"],
    report: Callable[[int], None] = lambda _: None,
    chunk: int = CHUNK,
) -> Any:
    """`function` of all points: of a batch of any length [k, n], with a pytree of arrays [k, ...] as its value.

    `report` is called with the number of points done.
    """
    return call_in_chunks(over_devices(function), points, chunk_size(len(points), chunk), report)


def call_in_chunks(
    run: Callable, points: Float[np.ndarray, "N n"], size: int, report: Callable[[int], None] = lambda _: None
) -> Any:
    """As `map_points`, for a function `run` that is compiled for chunks of one size already."""
    found = []
    for done, values in _chunks(run, points, 0, size):
        found.append(values)
        report(done)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)


def map_kept(
    function: Callable,
    points: Float[np.ndarray, "N n"],
    path: Path,
    report: Callable[[int], None] = lambda _: None,
    chunk: int = CHUNK,
) -> np.ndarray:
    """As `map_points`, for a function whose value is one array; the values [N, ...] are kept in a file.

    A file of the same function and points is read, and completed where it was left. Others, or a damaged file, begin
    anew.
    """
    program = lowered(function, jnp.asarray(points[:1]))
    value, settings = program.out_info, {"points": len(points), "digest": function_digest(program, points)}
    kept = agree(
        _read(path, settings, len(points), value.shape[1:]) if is_first_process() else None,
        value.shape[1:],
        value.dtype,
    )
    if len(kept) == len(points):
        return kept
    found = [kept]

    def keep() -> np.ndarray:
        values = np.concatenate(found)
        if is_first_process():
            save_result(path, {"values": values}, {"settings": settings})
        return values

    written = time.monotonic()
    for done, values in _chunks(over_devices(function), points, len(kept), chunk_size(len(points) - len(kept), chunk)):
        found.append(values)
        report(done)
        if time.monotonic() - written > _SECONDS_BETWEEN_WRITES:
            keep()
            written = time.monotonic()
    return keep()


def chunk_size(number: int, chunk: int) -> int:
    """Points in each of the fewest equal chunks of so many, with at most `chunk` on a core, or `ON_GPU` as many."""
    devices = jax.device_count()
    most = chunk * devices * (1 if jax.default_backend() == "cpu" else ON_GPU)
    chunks = -(-number // most)
    return devices * -(-number // (chunks * devices))


def _read(path: Path, settings: Mapping[str, Any], points: int, shape: tuple[int, ...]) -> np.ndarray | None:
    """The values [n, *shape] of at most so many points that a file made with these settings holds."""
    with contextlib.suppress(FileNotFoundError, DamagedFileError):
        arrays, attributes = load_result(path)
        if attributes.get("settings") == settings:
            (values,) = of_shapes(path, arrays, values=(None, *shape))
            return values if len(values) <= points else None
    return None


def _chunks(run: Callable, points: np.ndarray, done: int, size: int) -> Iterator[tuple[int, Any]]:
    """The number of points done and the values of the last chunk, again and again."""
    for first in range(done, len(points), size):
        some = points[first : first + size]
        whole = np.resize(some, (size, *some.shape[1:]))  # The last chunk is filled up with points of its own.
        yield first + len(some), jax.tree.map(operator.itemgetter(slice(len(some))), run(whole))
