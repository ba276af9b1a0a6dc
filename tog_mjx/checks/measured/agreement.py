"""Autodiff against central differences over a sweep of steps, and one-sided differences that tell a kink from an error.

Long steps see curvature and jumps, short ones rounding and the solver's tolerance: the error is a V over the step, and
differences mean something where a step and the next two shorter ones agree.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tog_mjx.checks.told.finding import Finding, Level

STEPS = np.logspace(-1, -9, 17)
"""Of the displacements, relative to the scale of each variable."""
ACCEPTED = 1e-4
"""Relative error of autodiff at the best step: a term that is left out is rarely so small, and four digits are more
than a descent can use."""
SETTLED = 1e-3
"""Relative change of differences from one step to the next. What they change by is what they know of their own error;
autodiff may be ten times as far from them, which is 1 % at most, and costs a descent nothing."""
BENT = 1e-2
"""Relative difference of the slopes to either side: a bend by less turns a step by half a degree."""
USABLE = 0.1
"""Relative error of a gradient that still shows the way: 6 degrees, or 10 % of a step's length."""
NARROW = 1e-4
"""A gradient that shows the way no farther than this is one of a piece too short to descend on: 10,000 steps so short
make one large displacement, and few descents take 1,000."""
TINY = 1e-6
"""Steps below a millionth see pieces that no descent meets: MJX takes lengths and rotations below 1e-8 for zero, and
what moves is flat there. Differences mean these only where no longer ones settle."""
ROUNDED = 1e-14
"""Change of a value, relative to all of them, that is none: sums in another order leave some ulps of float64."""
_SIZE = "a variable's size"
"""What steps are relative to: the length of a direction."""
REMEDY = "see 'solver' and 'differentiation': a converged solver, or tog.step, may mend it"
"""Of a scene on MJX."""
OF_A_FUNCTION = (
    "a converged solver, or tog.step for mjx.step, may mend it; else look for a stop_gradient, or a rule of its own"
)
OF_C_MUJOCO = (
    "let the solver converge, by <option tolerance='1e-12'/>; or take engine mjx, which takes no differences: here one "
    "crosses a touch, or is rounded, as numbers are large"
)
OUTSIDE = "neither, nor between them"


class Sweep(NamedTuple):
    """Differences for each step h [H]: `ahead` and `behind` [H, m, k], and whether a value stays the same at every
    step, [m, k]."""

    steps: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray
    constant: np.ndarray

    @property
    def central(self) -> np.ndarray:
        return (self.ahead + self.behind) / 2


def sweep(
    values: Callable[[Float[np.ndarray, "N n"]], Float[np.ndarray, "N m"]],
    x: Float[np.ndarray, " n"],
    directions: Float[np.ndarray, "n k"],
    steps: Float[np.ndarray, " H"] = STEPS,
) -> Sweep:
    """Values at x, and a step ahead and behind along each direction, for each step."""
    k = directions.shape[1]
    shifts = steps[:, None, None] * directions.T
    points = np.concatenate([x[None], (x + np.stack([shifts, -shifts])).reshape(-1, len(x))])
    found = np.asarray(values(points))
    centre, (ahead, behind) = found[0], found[1:].reshape(2, len(steps), k, -1)
    h = steps[:, None, None]
    rounded = ROUNDED * np.linalg.norm(centre)
    constant = ((np.abs(ahead - centre) <= rounded) & (np.abs(behind - centre) <= rounded)).all(axis=0).T
    return Sweep(steps, np.swapaxes(ahead - centre, 1, 2) / h, np.swapaxes(centre - behind, 1, 2) / h, constant)


def agreement(slopes: Float[np.ndarray, "m k"], differences: Sweep, remedy: str = OF_A_FUNCTION) -> Finding:
    """Does the gradient agree with differences, and over which distance does it hold? With the `remedy` of one that is
    wrong."""
    central = differences.central
    errors = np.array([relative(slopes, some) for some in central])
    changes = settling(differences)
    best = int(changes.argmin())
    curves = {"step": differences.steps.tolist(), "error": errors.tolist(), "change": changes.tolist()}
    holds = differences.steps[errors <= USABLE]
    reach = f"it holds to {USABLE:.0%} over steps of up to {holds.max():.0e} of {_SIZE}" if len(holds) else ""
    error, settled, step = errors[best], changes[best], differences.steps[best]

    def say(level: Level, sentence: str, remedy: str = "") -> Finding:
        return Finding("agreement", level, sentence, float(error), remedy, curves)

    if not np.isfinite(slopes).all():
        return say(
            Level.FAULT, "the gradient is not finite, so there is nothing to compare", "see the finding 'finite'"
        )
    if side := kink(slopes, differences):
        return say(
            Level.FAULT if side == OUTSIDE else Level.CARE,
            f"the point lies on a kink: the slopes to either side differ, and autodiff is {side}",
            "move the point, or average over small perturbations: the estimators tell whether that helps",
        )
    if error <= max(ACCEPTED, 10 * settled) and settled <= SETTLED:
        if holds.max() < NARROW:
            short = "treat it as the gradient of a short piece: take small steps, or smooth the objective"
            return say(Level.CARE, f"autodiff agrees with differences to {error:.0e}, but {reach} only", short)
        return say(
            Level.FINE,
            f"autodiff agrees with central differences to {error:.0e} (at a step of {step:.0e} of {_SIZE}); {reach}",
        )
    if settled <= SETTLED:
        is_flat = reach and holds.max() < TINY
        told = f"autodiff is wrong by {error:.0e}: " + (
            f"{reach}, too short a piece to move on, and " if is_flat else ""
        )
        return say(
            Level.FAULT,
            told + f"differences settle elsewhere, to {settled:.0e} at a step of {step:.0e} of {_SIZE}",
            remedy,
        )
    # What is right at no step is confirmed by none; what is right over some is a gradient between jumps.
    return say(
        Level.CARE if reach else Level.FAULT,
        f"differences never settle (they change by {settled:.0e} at best): the function jumps within a step's length; "
        + (reach or f"over none of the steps does autodiff come within {USABLE:.0%} of them"),
        "soften the contact, or average over perturbations: the estimators tell over which",
    )


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """How far apart two arrays are, relative to the larger one; 0 where both are 0, NaN where one is not finite."""
    size = max(np.linalg.norm(a), np.linalg.norm(b))
    return float(np.linalg.norm(a - b) / size) if size else 0.0


def settling(differences: Sweep) -> Float[np.ndarray, " H"]:
    """How much differences change from each step to its neighbours: two may agree by chance, three hardly.

    Infinite where there is no neighbour, and at steps below `TINY` where longer ones settle.
    """
    changes = np.array([relative(a, b) for a, b in itertools.pairwise(differences.central)])
    changes = np.maximum(changes[:-1], changes[1:])
    is_seen = (changes <= SETTLED) & (differences.steps[2:] >= TINY)
    is_left_out = is_seen.any() & (differences.steps[2:] < TINY) | np.isnan(changes)
    return np.r_[np.inf, np.where(is_left_out, np.inf, changes), np.inf]


def between_jumps(
    judged: Finding, slopes: Float[np.ndarray, "m k"], plain: Float[np.ndarray, "m k"], differences: Sweep
) -> Finding:
    """What is said of a gradient with jumps that differences contradict, where `plain` is the gradient without them.

    Short differences see a jump only where it lies between their points; a gradient with jumps has its share also where
    it falls on another time step, next to the point.
    """
    without = agreement(plain, differences)
    share = relative(plain, slopes)
    if without.level == Level.FAULT or share <= ACCEPTED:
        return judged
    sentence = (
        f"between jumps autodiff agrees with differences to {without.value:.0e}; {share:.0%} of the gradient are jumps "
        "that the time grid has elsewhere, and short differences cannot see them"
    )
    remedy = "compare with differentiation='implicit', or average over a few starts, as far apart as jumps are"
    return dataclasses.replace(judged, level=Level.CARE, sentence=sentence, value=without.value, remedy=remedy)


def kink(slopes: Float[np.ndarray, "m k"], differences: Sweep) -> str:
    """Where the slopes to either side stay apart, by the same, as the step shrinks: which of them autodiff takes."""
    middle = (differences.steps <= 1e-3) & (differences.steps >= 1e-7)
    size = max(np.linalg.norm(slopes), np.linalg.norm(differences.central[middle], axis=(1, 2)).min())
    apart = np.linalg.norm((differences.ahead - differences.behind)[middle], axis=(1, 2)) / (size or 1.0)
    # Curvature would make it shrink with the step, a jump grow: only a kink keeps it.
    stays = (apart > BENT) & (np.abs(np.gradient(np.log(np.maximum(apart, 1e-300)))) < 0.1)
    if stays.sum() < 3:
        return ""
    at = np.flatnonzero(middle)[np.flatnonzero(stays)[-1]]
    for name, side in (("the one ahead", differences.ahead[at]), ("the one behind", differences.behind[at])):
        if relative(slopes, side) < BENT:
            return name
    low, high = np.sort([differences.ahead[at], differences.behind[at]], axis=0)
    is_between = (slopes >= low - BENT * size) & (slopes <= high + BENT * size)
    return "between them" if is_between.all() else OUTSIDE
