"""Central differences: at one step, as an estimator, and with the step at which they have settled."""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from tog_mjx.gradients.estimator import Estimator, Objective
from tog_mjx.gradients.perturbation import Size, check_positive
from tog_mjx.running.types import AnyArray

_STENCILS = {2: ((0.5, 1.0),), 4: ((2 / 3, 1.0), (-1 / 12, 2.0))}
"""By order: weights w and distances d of the sum over w [f(x + d h) - f(x - d h)] / h."""


def central_differences(objective: Objective, step: Size) -> Estimator:
    """[J(u + h e_i) - J(u - h e_i)] / (2 h) along each axis, [n]; 2 n + 1 evaluations, one batch.

    Deterministic. Its error is (h^2 / 6) d^3 J / du_i^3 + O(h^4), none for a quadratic, and rounding of about
    |J| eps / h. Across a jump of J by D it is D / (2 h). `settled_differences` chooses h.

    Args:
      objective: need not be differentiable.
      step: h, in the units of u; positive.

    Raises:
      InputError: for a step known not to be positive and finite.

    Units: J's per unit of u.
    Gradient: what it returns is a difference: at a kink the mean of both slopes, across a jump by D, D / (2 h) more.
    Source: Taylor's formula.
    """
    check_positive("step", step, "a difference needs a positive step")

    def estimate(key: Key[Array, ""], u: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, " n"]]:
        del key
        shifts = step * jnp.eye(u.size, dtype=u.dtype)
        costs = jax.vmap(objective)(jnp.concatenate([u[None], u + shifts, u - shifts]))
        ahead, behind = jnp.split(costs[1:], 2)
        return costs[0], (ahead - behind) / (2 * step)

    return estimate


class Differences(NamedTuple):
    """Jacobians [b, m, n] of b points, and their largest change [b] at the last halving, relative to their norm.

    Units: of the values per unit of x; the change has none.
    """

    jacobian: np.ndarray
    change: np.ndarray


def halvings(first: float, number: int) -> tuple[float, ...]:
    """A step, its half, and so on: that many steps."""
    return tuple(first / 2**i for i in range(number))


def settled_differences(
    values: Callable[[Float[AnyArray, "N n"]], Float[AnyArray, "N m"]],
    x: Float[AnyArray, "b n"],
    steps: Sequence[float],
    order: int = 2,
) -> Differences:
    """The Jacobian of `values` at each of b points, with the step at which it has settled: the reference for every
    derivative here.

    A large step sees curvature, and the jumps of a contact's law; a small one sees rounding and the solver's tolerance.
    So the step is halved again and again, and the estimate is taken where halving changes it least. How much it changes
    there says how far to trust it.

    Args:
      values: a function of n numbers with m results, of N points at a time: [N, n] to [N, m].
      x: the points [b, n].
      steps: at least two, each half of the one before.
      order: of the error in the step, 2 or 4.

    Units: of the values per unit of x; a step is in units of x.
    Gradient: none of it, it is NumPy's. Within a step of a jump or a kink it does not settle, and its change says so.
    Source: own; central differences of order 2 and 4.
    """
    points, n = x.shape
    directions = np.eye(n)
    estimates = []
    for h in steps:
        jacobian = 0.0
        for weight, distance in _STENCILS[order]:
            shift = distance * h * directions
            shifted = np.asarray(x)[:, None, None, :] + np.stack([shift, -shift])[None]
            found = np.asarray(values(shifted.reshape(-1, n))).reshape(points, 2, n, -1)
            jacobian = jacobian + weight / h * (found[:, 0] - found[:, 1])
        estimates.append(np.swapaxes(jacobian, 1, 2))
    size = np.linalg.norm(estimates, axis=(2, 3))
    changes = np.array([np.linalg.norm(b - a, axis=(1, 2)) for a, b in itertools.pairwise(estimates)])
    best, each = changes.argmin(0), np.arange(points)
    scale = size[best + 1, each]
    relative = np.divide(changes[best, each], scale, out=changes[best, each].copy(), where=scale > 0)
    return Differences(np.array(estimates)[best + 1, each], relative)
