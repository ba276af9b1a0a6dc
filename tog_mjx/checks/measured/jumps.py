"""What autodiff does not see: jumps between the point and where a descent steps next, and the slope they add up to.

Over a window of half width h the values at N points are compared with what their own slopes, by differences too short
to meet a jump, add up to from point to point. Curvature is in both; what is left over in a cell is a jump, or something
so steep that no slope nearby tells of it. A jump stays as large as it is where its cell is divided; curvature vanishes.

The slope over a window is that of least squares: the derivative of the function averaged over the window with weights
1 - (t/h)^2, in which jumps at a distance s count to (s/h)^2, where a central difference has s/h.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tog_mjx.checks.measured.agreement import SETTLED, USABLE, Sweep, settling
from tog_mjx.checks.told.finding import Finding, Level

POINTS = 20
"""In a window."""
MOST = 2
"""Directions in which a window is searched: those in which differences depart most."""
PARTS = 31
"""Of a cell that is searched for its jump."""
MANY = 3.0
"""Cells over which jumps of the same sign are spread, at least, to be a slope and not a single event."""
WHOLE = 0.3
"""Of what is left over in a cell, the least in one of its parts if it is a jump: two or three may share it."""
FELT = 1e-2
"""A derivative smaller than this, of the largest of all outputs, is judged as if it were as large."""
SHORT = 1.1e-4
"""Steps up to here see no jump, if differences settle over them."""
REACH = 0.99e-2
"""A single jump within this, of a large displacement, is in the way of a descent of a hundred steps; a nearer one that
is not felt so far is too small to matter."""
CLOSE = 1e-8
"""Width to which a jump is narrowed down, of a large displacement."""
REMEDY = (
    "differentiate with differentiation='saltation'; or let solimp, and so the force, begin at 0 and rise over more "
    "than the travel of a step; or smooth: tog_mjx.gradients.zeroth_order"
)
Values = Callable[[Float[np.ndarray, "N n"]], Float[np.ndarray, "N m"]]


class Jumps(NamedTuple):
    """Jumps over a window of half width `width`, in the derivative in which they count most, `entry`: of an output,
    along a direction; without jumps in that which differs most over the window.

    `slope` is that over the window, `short` that of differences at its middle which see no jump, and `size` what they
    are compared with; `number` the cells over which jumps are spread; `sides` [2, n] are points to either side of one
    of them. `slopes` [m, k] are all that are known over the window, NaN elsewhere. `line` [2, N] are displacements and
    the values there, of `entry`.
    """

    width: float
    entry: tuple[int, int]
    slope: float
    short: float
    size: float
    slopes: np.ndarray
    line: np.ndarray
    number: float = 0.0
    sides: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def are_many(self) -> bool:
        return self.number >= MANY


def find_jumps(
    values: Values, x: Float[np.ndarray, " n"], directions: Float[np.ndarray, "n k"], differences: Sweep
) -> Jumps | None:
    """The jumps within the first window that has many, and whose next wider one has many too, or within that if it is
    needed to average them; else those within the first that a descent feels; else, without jumps, the second of
    two windows with the same slope, another than at their middle. None if there is nothing of the kind.

    Windows are as wide as the steps at which differences say something else than short ones that settle, along the
    directions in which they say so.
    """
    central, steps = differences.central, differences.steps
    best = _settled(differences)
    many = few = bend = last = None
    for at in () if best is None else reversed(np.flatnonzero(steps >= POINTS * steps[best])):
        departures = _shares(central[at], central[best]).max(axis=0, initial=0.0)
        columns = [i for i in np.argsort(-departures)[:MOST].tolist() if departures[i] > USABLE]
        args = columns, float(steps[at]), steps[best].item(), central[best]
        found = _within(values, x, directions, *args) if columns else None
        if found and found.are_many and many:
            return many if many.number >= 2 * MANY else found
        many = found if found and found.are_many else None
        few = few or (found if found and found.number and steps[at] >= REACH else None)
        bend = bend or (found if found and last and _is_same(last, found) else None)
        last = found
    return many or few or bend


def _is_same(narrow: Jumps, wide: Jumps) -> bool:
    """Whether the slope is the same over both windows, and another than at their middle."""
    apart = abs(narrow.slopes[wide.entry] - wide.slope) / wide.size
    return bool(apart <= USABLE < abs(wide.short - wide.slope) / wide.size)


def _settled(differences: Sweep) -> int | None:
    """The step of differences that settle and see no jump; None if none do."""
    changes = settling(differences)
    settled = changes <= SETTLED
    short = settled & (differences.steps <= SHORT)
    chosen = short if short.any() else settled
    return int(np.where(chosen, changes, np.inf).argmin()) if chosen.any() else None


def _shares(a: Float[np.ndarray, "m k"], b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "m k"]:
    """How far apart derivatives are, relative to all those of the same output."""
    size = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    return np.abs(a - b) / _felt(size)[:, None]


def _felt(size: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Sizes of derivatives, none of them so small that it would not be felt beside the others, or zero."""
    return np.maximum(size, FELT * size.max(initial=0.0)) if size.any() else np.ones_like(size)


def _within(
    values: Values,
    x: np.ndarray,
    directions: np.ndarray,
    columns: Sequence[int],
    width: float,
    short: float,
    shortest: Float[np.ndarray, "m k"],
) -> Jumps | None:
    """The jumps within one window, along the directions in `columns`; `shortest` are the differences by `short`."""
    directions = directions[:, columns]
    # At random within its cell, so that no period of the function meets that of the points.
    at = width * (2 * (np.arange(POINTS) + np.random.default_rng(0).uniform(size=POINTS)) / POINTS - 1)
    shifts = at[:, None] + short * np.array([-1.0, 0.0, 1.0])
    points = x + shifts[..., None, None] * directions.T  # [N, 3, k, n]
    found = np.asarray(values(points.reshape(-1, len(x))), float).reshape(*points.shape[:3], -1).swapaxes(2, 3)
    if not np.isfinite(found).all():
        return None
    behind, value, ahead = np.moveaxis(found, 1, 0)  # [N, m, k]
    left, right = (value - behind) / short, (ahead - value) / short
    # A jump so near is on one side alone, and makes its slope the larger one.
    slopes = np.where(np.abs(left) < np.abs(right), left, right)
    rises = np.diff(at)[:, None, None] * (slopes[1:] + slopes[:-1]) / 2
    jumps = np.diff(value, axis=0) - rises
    slope = _least_squares(at, value)
    between = _least_squares(at, np.concatenate([0 * value[:1], np.cumsum(rises, axis=0)]))
    size = _felt(np.maximum(np.linalg.norm(slope, axis=1), np.linalg.norm(slopes, axis=2).mean(axis=0)))
    known = np.full(shortest.shape, np.nan)
    known[:, columns] = slope

    def made(shares: np.ndarray, *jumps: Any) -> Jumps:
        i, j = np.unravel_index(shares.argmax(), shares.shape)
        entry = int(i), columns[int(j)]
        line = np.stack([at, value[:, i, j]])
        return Jumps(
            width, entry, slope[i, j], shortest[entry], max(size[i], abs(shortest[entry])), known, line, *jumps
        )

    shares = np.abs(slope - between) / size[:, None]
    i, j = np.unravel_index(shares.argmax(), shares.shape)
    some = jumps[:, i, j]
    cell = int(np.abs(some).argmax())
    line = lambda t: np.asarray(values(x + t[:, None] * directions[:, j]), float)[:, i]  # noqa: E731
    is_felt = shares[i, j] > USABLE
    ends = _sides(line, at[cell], at[cell + 1], rises[cell, i, j], some[cell]) if is_felt else None
    if ends is None:
        return made(np.abs(slope - shortest[:, columns]) / size[:, None])
    return made(shares, float(some.sum() ** 2 / (some**2).sum()), tuple(x + t * directions[:, j] for t in ends))


def _sides(line: Callable, low: float, high: float, rise: float, jump: float) -> tuple[float, float] | None:
    """The two sides of the largest jump of a function of one number between two points, where it rises by `jump` more
    than the `rise` of its slopes; None if it has none, but bends."""
    slope, found = rise / (high - low), None
    while high - low > CLOSE:
        t = np.linspace(low, high, PARTS + 1)
        parts = np.abs(np.diff(line(t)) - slope * np.diff(t))
        part = int(parts.argmax())
        if not parts[part] >= WHOLE * abs(jump):
            break
        low, high, jump = found = t[part], t[part + 1], parts[part]
    return found and found[:2]


def _least_squares(at: Float[np.ndarray, " N"], values: Float[np.ndarray, "N m k"]) -> Float[np.ndarray, "m k"]:
    """Slope of the line through values at N points."""
    centred = at - at.mean()
    return np.einsum("i, imk -> mk", centred, values) / (centred @ centred)


def lacks(slopes: Float[np.ndarray, "m k"], jumps: Jumps | None) -> bool:
    """Whether a gradient is that between jumps, where many of them add up to another slope."""
    if jumps is None or not jumps.are_many:
        return False
    away, off = (abs(slopes[jumps.entry] - other) / jumps.size for other in (jumps.short, jumps.slope))
    return bool(away <= USABLE < off)


def judge_jumps(
    plain: Finding,
    slopes: Float[np.ndarray, "m k"],
    jumps: Jumps | None,
    variables: Sequence[str],
    outputs: Sequence[str],
    where: Callable[[Jumps], str] = lambda _: "",
    scale: Float[np.ndarray, " k"] | None = None,
) -> Finding:
    """What differences say of a gradient, `plain`, where jumps are known: only then do wide ones mean something.

    Args:
      where: says what jumps there, if that is known.
      scale: the length of each direction: derivatives and windows are told in units of the variables. 1 if None.
    """
    if jumps is None or not np.isfinite(slopes).all():
        return plain
    (i, j), slope = jumps.entry, slopes[jumps.entry]
    unit = 1.0 if scale is None else float(scale[j])
    width = jumps.width * unit
    error = float(abs(slope - jumps.slope) / jumps.size)
    seen = f"d {outputs[i]} / d {variables[j]} is {slope / unit:.3g}"
    wide = f"over {width:.1g} the slope is {jumps.slope / unit:.3g}"

    def say(level: Level, sentence: str, remedy: str = "") -> Finding:
        curves = along_the_line(plain.curves, jumps, slope, unit)
        return dataclasses.replace(plain, level=level, sentence=sentence, value=error, remedy=remedy, curves=curves)

    if lacks(slopes, jumps):
        told = f"the derivative is that between two jumps: {seen}, but {wide}"
        return say(Level.FAULT, _with(told, where(jumps)), REMEDY)
    if not jumps.are_many and plain.level > Level.FINE:
        return plain
    if not jumps.number:
        told = f"differences settle twice, and the derivative is that of a short piece: {seen}, but {wide}"
        return say(
            Level.CARE, told, "try another time step, or average over perturbations: the estimators tell over which"
        )
    if not jumps.are_many:
        told = f"the function jumps within {width:.1g}, which the derivative does not see: {seen}, {wide}"
        remedy = "take smaller steps, or average over perturbations: the estimators tell over which"
        return say(Level.CARE, _with(told, where(jumps)), remedy)
    if plain.level < Level.FAULT:
        return plain
    if error <= USABLE:
        return say(Level.FINE, f"autodiff agrees to {error:.0e} with the slope over {width:.1g}, jumps included")
    if error > abs(jumps.short - jumps.slope) / jumps.size / 2:
        return plain
    told = f"the derivative has the jumps, as they lie on the grid of time steps: {seen}, {wide}"
    return say(Level.CARE, _with(told, where(jumps)), "average over a few starts, as far apart as jumps are")


def along_the_line(
    curves: Mapping[str, Sequence[float]], jumps: Jumps, slope: float, unit: float
) -> dict[str, Sequence[float]]:
    """Curves, and how the function changes along the line where the jumps are, from the point next to the middle:
    itself, by autodiff's `slope`, and by that over the window. All are made as long as the longest, by NaN."""
    away, change = jumps.line - jumps.line[:, [np.abs(jumps.line[0]).argmin()]]
    along = {
        "displacement": jumps.line[0] * unit,
        "function": change,
        "along the gradient": slope * away,
        "along the slope over the window": jumps.slope * away,
    }
    lists = {**curves, **{name: y.tolist() for name, y in along.items()}}
    most = max(map(len, lists.values()))
    return {name: [*curve, *[np.nan] * (most - len(curve))] for name, curve in lists.items()}


def _with(told: str, where: str) -> str:
    return f"{told}; {where}" if where else told
