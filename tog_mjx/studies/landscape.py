"""The cost and its gradient over a plane of a problem's variables.

Of a problem with many starts J is the mean over those of one key.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines import ENGINES, objective, precision
from tog_mjx.engines.choice import resolved
from tog_mjx.gradients import exact_batch
from tog_mjx.problems import Plane, Problem, Starts
from tog_mjx.problems.library import get_problem
from tog_mjx.running.batches import map_kept, map_points
from tog_mjx.running.errors import require_whole
from tog_mjx.running.older_names import older_keywords
from tog_mjx.running.types import Scalar


class Landscape(NamedTuple):
    """Costs [size, size] over `points` [size * size, 2] of a plane: row i has its i-th second coordinate.

    Units: of points those of the plane, of costs those of J.
    """

    points: np.ndarray
    costs: np.ndarray


class GradientField(NamedTuple):
    """Gradients of J [N, 2] along the axes of a plane, at its `points` [N, 2].

    Units: of points those of the plane, of gradients J's per unit of those.
    """

    points: np.ndarray
    gradients: np.ndarray


@older_keywords(task="problem", simulator="engine")
def landscape(
    problem: str | Problem,
    engine: str = "mjx",
    plane: Plane | None = None,
    size: int = 40,
    folder: Path | None = None,
    report: Callable[[int], None] = lambda _: None,
    **options: str,
) -> Landscape:
    """J [size, size] at points of a plane, its edges included, in the precision of the engine.

    Args:
      engine, options: as in `tog.objective`.
      plane: by default `problem.plane`, that of the first two variables through the guess.
      folder: where the costs are kept; what was killed goes on there.
      report: called with the number of points done.

    Raises:
      InputError: as `tog.objective` and `Plane.of`, and for a size that is no positive number.

    Units: of J, and of the plane's variables.
    """
    problem, size = get_problem(problem), require_whole("size", size, 1)
    plane = plane or problem.plane
    costs = _over(problem, engine, plane, plane.grid(size), jax.vmap, folder, f"landscape_{size}", report, options)
    return Landscape(plane.grid(size), costs.reshape(size, size))


@older_keywords(task="problem", simulator="engine")
def gradient_field(
    problem: str | Problem,
    engine: str = "mjx",
    plane: Plane | None = None,
    size: int = 12,
    folder: Path | None = None,
    report: Callable[[int], None] = lambda _: None,
    **options: str,
) -> GradientField:
    """The gradient at the centres of `size` x `size` cells of a plane. Else as `tog.landscape`.

    Raises:
      InputError: as `tog.landscape`.

    Units: of J per unit of the plane's variables.
    Gradient: what it returns is that of `tog.objective`, along the axes of the plane.
    Source: as `tog.objective`.
    """
    problem, size = get_problem(problem), require_whole("size", size, 1)
    plane = plane or problem.plane
    points = plane.grid(size, centred=True)
    name = f"gradient_field_{size}"
    return GradientField(points, _over(problem, engine, plane, points, _slopes, folder, name, report, options))


def _slopes(function: Callable) -> Callable[[Any], Any]:
    both = exact_batch(function)
    return lambda points: both(points)[1]


def _over(
    problem: Problem,
    engine: str,
    plane: Plane,
    points: Float[np.ndarray, "N 2"],
    batched: Callable[[Callable], Callable],
    folder: Path | None,
    name: str,
    report: Callable[[int], None],
    options: dict[str, str],
) -> np.ndarray:
    """What `batched` makes of J, at all points."""
    motions = problem.start.count if isinstance(problem.start, Starts) else 1
    engine = resolved(problem, engine, options)
    with precision(engine, **options):  # Which knows the names.
        chunk = max(1, ENGINES[engine].CHUNK // motions)
        J = objective(problem, engine, **options)

        def cost(p: Float[Array, "2"]) -> Scalar:
            return J(plane.x(p))

        function = batched(cost)
        if folder is None:
            return map_points(function, points, report, chunk)
        return map_kept(function, points, folder / f"{name}.npz", report, chunk)
