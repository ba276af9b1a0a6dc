"""A plane through a problem's variables, to look at what depends on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from tog_mjx.running.errors import InputError, require_choice
from tog_mjx.running.types import Numbers


@dataclass(frozen=True, eq=False)
class Plane:
    """x [n] = origin [n] + p @ axes [2, n], for points p [2] from `low` [2] to `high` [2]; `names` are those of p.

    Units: of x, of low and of high those of the problem's variables.
    Gradient: x is linear in p, so that J along a plane has that of `tog.objective`; `project` and `grid` are NumPy's.
    """

    origin: Float[np.ndarray, " n"]
    axes: Float[np.ndarray, "2 n"]
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    names: tuple[str, str]

    @classmethod
    def of(
        cls,
        problem: Any,
        first: str | int = 0,
        second: str | int = 1,
        through: Numbers | None = None,
        window: Numbers | None = None,
    ) -> "Plane":
        """That of two variables, which are its coordinates; the others are as in x = `through` [n], or the guess.

        Args:
          first, second: names of variables, or their numbers.
          window: [2, 2], least and largest value of each; by default its bounds, and where there are none, `scale` to
            either side of x.

        Raises:
          InputError: for a variable that the problem does not have, twice the same, or an empty window.
        """
        x = np.asarray(problem.x0 if through is None else problem.check(through))
        chosen = [_number(which, problem.bound.names) for which in (first, second)]
        if chosen[0] == chosen[1]:
            raise InputError(f"both variables are {problem.bound.names[chosen[0]]}; a plane takes two")
        limits, beside = np.transpose(problem.limits), x[:, None] + np.outer(problem.bound.scale, [-1, 1])
        default = np.where(np.isfinite(limits), limits, beside)[chosen]
        sides = default if window is None else np.asarray(window, float)
        if sides.shape != (2, 2) or not (sides[:, 0] < sides[:, 1]).all():
            raise InputError(f"the window {sides.tolist()} is none; give (least, largest) of both variables")
        origin = x.copy()
        origin[chosen] = 0
        names = tuple(problem.bound.names[i] for i in chosen)
        return cls(origin, np.eye(len(x))[chosen], sides[:, 0], sides[:, 1], (names[0], names[1]))

    def x(self, p: Float[Array | np.ndarray, "*N 2"]) -> Float[Array | np.ndarray, "*N n"]:
        """The variables [..., n] at points [..., 2]."""
        # Not p @ axes, which a GPU rounds.
        return self.origin + p[..., :1] * self.axes[0] + p[..., 1:] * self.axes[1]

    def project(self, x: Float[Array | np.ndarray, "*N n"]) -> Float[np.ndarray, "*N 2"]:
        """The points [..., 2] nearest to variables [..., n]."""
        return (np.asarray(x) - self.origin) @ np.linalg.pinv(self.axes)

    def grid(self, size: int, centred: bool = False) -> Float[np.ndarray, "N 2"]:
        """`size` x `size` points [N, 2], edges included, or the centres of as many cells, by the first axis first."""
        fractions = (np.arange(size) + 0.5) / size if centred else np.linspace(0, 1, size)
        first, second = (low + (high - low) * fractions for low, high in zip(self.low, self.high, strict=True))
        return np.stack(np.meshgrid(first, second), axis=-1).reshape(-1, 2)


def _number(which: str | int, names: Sequence[str]) -> int:
    if isinstance(which, int):
        if not 0 <= which < len(names):
            raise InputError(f"there is no variable {which}; the problem has {len(names)}, from 0 on")
        return which
    require_choice("the variable", which, names)
    return list(names).index(which)
