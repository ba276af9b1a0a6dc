"""Gradients of one task by several methods, at the same random setpoints, and how far they agree.

A piece of the study is one task and one method. Its result is a file that is made once, kept, and read again.
"""

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.engines import Simulator, make_simulator, reference
from tog_mjx.engines.objective import final_cost, objective
from tog_mjx.gradients import exact
from tog_mjx.mjcf.scene import Scene
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.paper.terms import TERMS
from tog_mjx.running.digests import made_with
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import DamagedFileError, load_result, of_shapes, save_result
from tog_mjx.running.types import Scalar

REFERENCE = "C MuJoCo, differences"
MJX, PENALTY, C_MUJOCO = "mjx, implicit", "penalty", "C MuJoCo, linearised"
_SIMULATORS: dict[str, Callable[[Scene], Simulator]] = {
    MJX: partial(make_simulator, "mjx"),
    "mjx, implicit, float32": partial(make_simulator, "mjx"),
    "mjx, native": partial(make_simulator, "mjx", differentiation="native"),
    PENALTY: partial(make_simulator, "penalty"),
    "penalty, paper's friction": partial(make_simulator, "penalty", friction="paper"),
    "released": partial(make_simulator, "released"),
    **TERMS,
}
METHODS = (REFERENCE, C_MUJOCO, *(name for name in _SIMULATORS if name not in TERMS))
"""The methods of the study; those of `TERMS` may be added."""

CHUNK = 25
"""Setpoints computed at a time."""
_NO_GRADIENT = 1e-9
"""The norm of dJ/du [1/m] below which the setpoints do not matter: the fingers never meet the box."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """Gradients of one task by one method at `points` random setpoints of its landscape window."""

    task: str
    method: str
    points: int
    seed: int

    def path(self, out: Path) -> Path:
        return out / self.task / f"{self.method.replace(', ', '-').replace(' ', '_').replace(chr(39), '')}.npz"

    def settings(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), **made_with(get_task(self.task).scene.model, __name__)}


class Gradients(NamedTuple):
    """setpoints [N, n], gradients [N, n] and, of differences, their change [N] at the last halving (else 0).

    `seconds_run` is for all of them.
    """

    setpoints: np.ndarray
    gradients: np.ndarray
    change: np.ndarray
    seconds_compile: float
    seconds_run: float


def draw_setpoints(task: Task, points: int, seed: int) -> Float[np.ndarray, "N n"]:
    """Uniform in the landscape window."""
    low, high = np.array(task.window).T
    window = np.random.default_rng(seed).uniform(low, high, (points, 2))
    with jax.enable_x64():
        return np.array([task.expand(point) for point in window])


def compute(piece: Piece, report: Callable[[int], None]) -> Gradients:
    """`report` is called with the number of setpoints done."""
    task = get_task(piece.task)
    setpoints = draw_setpoints(task, piece.points, piece.seed)
    if piece.method == REFERENCE:
        chunks, seconds_compile = _differences(task, setpoints), 0.0
    else:
        with _precision(piece.method):
            gradient, seconds_compile = _compile_gradient(task, _cost(task, piece.method))
            chunks = _in_chunks(gradient, setpoints)
    found, start = [], time.perf_counter()
    report(0)
    with _precision(piece.method):
        for chunk in chunks:
            found.append(chunk)
            report(min(len(found) * CHUNK, piece.points))
    seconds_run = time.perf_counter() - start
    gradients, change = (np.concatenate(part) for part in zip(*found, strict=True))
    return Gradients(setpoints, gradients, change, seconds_compile, seconds_run)


def _differences(task: Task, setpoints: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for differences in reference.gradients(task, setpoints, CHUNK):
        yield differences.jacobian[:, 0], differences.change


def _cost(task: Task, method: str) -> Callable[[jax.Array], Scalar]:
    if method == C_MUJOCO:
        return objective(task, "mujoco")
    return partial(final_cost, task, _SIMULATORS[method](task.scene))


def _compile_gradient(task: Task, cost: Callable[[jax.Array], Scalar]) -> tuple[Callable[[Any], jax.Array], float]:
    """dJ/du of a chunk of setpoints, compiled, and the seconds that took."""
    estimate = exact(cost, "forward")
    batch = jnp.zeros((CHUNK, task.initial_guess.size))
    start = time.perf_counter()
    # One after the other: compiled sooner than a batch, and timed as one gradient.
    run = jax.jit(lambda us: jax.lax.map(lambda u: estimate(jax.random.key(0), u)[1], us)).lower(batch).compile()
    return run, time.perf_counter() - start


def _in_chunks(gradient, setpoints: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The last chunk is filled up, as the compiled function has one shape."""
    for first in range(0, len(setpoints), CHUNK):
        chunk = setpoints[first : first + CHUNK]
        full = np.resize(chunk, (CHUNK, setpoints.shape[1]))
        yield np.asarray(gradient(jnp.asarray(full, float)), float)[: len(chunk)], np.zeros(len(chunk))


def _precision(method: str) -> contextlib.AbstractContextManager:
    return jax.enable_x64("float32" not in method)


def save(piece: Piece, found: Gradients, out: Path) -> None:
    arrays = {name: getattr(found, name) for name in ("setpoints", "gradients", "change")}
    seconds = {name: getattr(found, name) for name in ("seconds_compile", "seconds_run")}
    save_result(piece.path(out), arrays, {"settings": piece.settings(), **seconds})


def load(piece: Piece, out: Path) -> Gradients:
    """A piece that was kept.

    Raises:
      FileNotFoundError, DamagedFileError: if there is none, or not a whole one.
      InputError: if the file holds the result of other settings.
    """
    path = piece.path(out)
    arrays, attributes = load_result(path)
    settings = attributes.get("settings")
    if settings != piece.settings():
        same = isinstance(settings, dict) and all(settings.get(k) == v for k, v in dataclasses.asdict(piece).items())
        what = "another version of the program or the scene" if same else "other points or another seed"
        raise InputError(f"{path} was made with {what}; choose another --out, or --force to replace it")
    try:
        seconds = float(attributes["seconds_compile"]), float(attributes["seconds_run"])
        if not all(0 <= some < np.inf for some in seconds):
            raise ValueError("seconds are none")
        points, n = piece.points, get_task(piece.task).initial_guess.size
        shapes: dict[str, tuple[int | None, ...]] = {"setpoints": (points, n), "gradients": (points, n)}
        setpoints, gradients, change = of_shapes(path, arrays, **shapes, change=(points,))
        return Gradients(setpoints, gradients, change, *seconds)
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(f"{path}: {error}") from None


class Agreement(NamedTuple):
    """One method against another, over the setpoints where the other is known and not zero.

    `finite` is the share of all setpoints; `compared` counts those that the rest is about. `within` is the share with a
    relative error of at most 1e-4. None where nothing can be compared.
    """

    points: int
    finite: float
    compared: int
    cosine_median: float | None
    cosine_p10: float | None
    relative_error_median: float | None
    relative_error_p90: float | None
    relative_error_worst: float | None
    within: float | None


def compare(found: Gradients, expected: Gradients) -> Agreement:
    """How far `found` agrees with `expected`, where differences have settled."""
    is_finite = np.isfinite(found.gradients).all(1)
    size = np.linalg.norm(expected.gradients, axis=1)
    chosen = is_finite & (expected.change <= reference.SETTLED) & (size > _NO_GRADIENT)
    g, r, size = found.gradients[chosen], expected.gradients[chosen], size[chosen]
    numbers: list[float | None] = [None] * 6
    if chosen.any():
        error = np.linalg.norm(g - r, axis=1) / size
        # A zero gradient has no direction: it is counted as orthogonal.
        cosine = (g * r).sum(1) / (size * np.maximum(np.linalg.norm(g, axis=1), np.finfo(float).tiny))
        quantiles = np.median(cosine), np.percentile(cosine, 10), np.median(error), np.percentile(error, 90)
        numbers = [float(x) for x in (*quantiles, error.max(), (error <= reference.SETTLED).mean())]
    return Agreement(len(is_finite), float(is_finite.mean()), int(chosen.sum()), *numbers)


def angles(g: Float[np.ndarray, "N n"], h: Float[np.ndarray, "N n"]) -> Float[np.ndarray, " K"]:
    """Angles in degrees between those K pairs of gradients that are both finite and not zero."""
    sizes = np.linalg.norm(g, axis=1), np.linalg.norm(h, axis=1)
    chosen = (sizes[0] > _NO_GRADIENT) & (sizes[1] > _NO_GRADIENT)
    a, b = g[chosen] / sizes[0][chosen, None], h[chosen] / sizes[1][chosen, None]
    # Right for small angles too, where the cosine is not.
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1)))


def summarise(piece: Piece, found: Gradients, expected: Gradients) -> dict[str, Any]:
    """One entry of summary.json: the method against the reference."""
    return {
        "task": piece.task,
        "method": piece.method,
        **compare(found, expected)._asdict(),
        "settled": float((found.change <= reference.SETTLED).mean()),
        "ms_per_gradient": 1e3 * found.seconds_run / len(found.setpoints),
        "seconds_compile": found.seconds_compile,
    }
