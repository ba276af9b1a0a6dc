"""A function of many points: compiled once for chunks of one size, and kept on disk as it goes."""

import contextlib
import json
import operator
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.storage import DamagedFileError, load_result, save_result

CHUNK = 64
"""Points computed at a time. More are not quicker on two cores."""
_SECONDS_BETWEEN_WRITES = 10


def map_points(
    function: Callable, points: Float[np.ndarray, "N n"], report: Callable[[int], None] = lambda _: None
) -> Any:
    """`function` (of one point [n], any pytree as its value) of every point: its value with a leading axis [N].

    `report` is called with the number of points done.
    """
    found = []
    for done, chunk in _chunks(function, points, 0):
        found.append(chunk)
        report(done)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)


def map_kept(
    function: Callable,
    points: Float[np.ndarray, "N n"],
    path: Path,
    settings: Mapping[str, Any],
    report: Callable[[int], None] = lambda _: None,
) -> np.ndarray:
    """As `map_points`, for a function whose value is one array; the values [N, ...] are kept in a file.

    A file made with the same settings is read, and completed where it was left. Settings are whatever the values depend
    on; others, or a damaged file, begin anew.
    """
    settings = json.loads(json.dumps({**settings, "points": len(points)}))
    found: list[np.ndarray] = []
    done = 0
    with contextlib.suppress(FileNotFoundError, DamagedFileError):
        arrays, attributes = load_result(path)
        if attributes.get("settings") == settings:
            found, done = [arrays["values"]], len(arrays["values"])
    if done == len(points):
        return found[0]

    def keep() -> np.ndarray:
        values = np.concatenate(found)
        save_result(path, {"values": values}, {"settings": settings})
        return values

    written = time.monotonic()
    for reached, chunk in _chunks(function, points, done):
        found.append(chunk)
        report(reached)
        if time.monotonic() - written > _SECONDS_BETWEEN_WRITES:
            keep()
            written = time.monotonic()
    return keep()


def _chunks(function: Callable, points: np.ndarray, done: int) -> Iterator[tuple[int, Any]]:
    """The number of points done and the values of the last chunk, again and again."""
    run = jax.jit(jax.vmap(function))
    for first in range(done, len(points), CHUNK):
        chunk = points[first : first + CHUNK]
        whole = np.resize(chunk, (CHUNK, *chunk.shape[1:]))  # The last chunk is filled up with points of its own.
        values = jax.tree.map(np.asarray, run(jnp.asarray(whole)))
        yield first + len(chunk), jax.tree.map(operator.itemgetter(slice(len(chunk))), values)
