"""Which variables and outputs have derivatives of zero, and why: they cannot matter, or do not matter here; or they
should and do not, as nothing is touched, nothing wired, or the code drops them."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from tog_mjx.checks.measured.agreement import STEPS, Sweep
from tog_mjx.checks.told.finding import Finding, Level

SHORTEST, SHORT = 0.9e-6, 1.1e-4
"""Steps of differences, relative to the variables' scale, that see the same piece as the gradient, and are not yet
drowned by rounding."""
STEADY = 0.5
"""Of the largest slope over these steps the least: a slope that is there is the same over all of them. What curvature
makes of it falls by 100 times or more as they shrink, what rounding makes of it grows."""
LONG, FALLS = 0.9e-3, 0.1
"""Of the slopes over steps from here on, a hundred times as long at most, the least by the largest. At an extremum they
fall by 100 times or more, and over a flat piece they end."""

ROUNDED, UNRESOLVED = 1e-8, 1e-6
"""Changes of an output over a large displacement, relative to the output, that are none: those that differences of the
compiler leave of a sum that is zero, and those that the solver's tolerance leaves of a motion that stays."""


def zeros(
    slopes: Float[np.ndarray, "m k"],
    differences: Sweep,
    variables: Sequence[str],
    outputs: Sequence[str],
    bodies: Int[np.ndarray, " m"] | None = None,
    untouched: Callable[[], str] = lambda: "",
    kin: Int[np.ndarray, " k"] | None = None,
    unused: Bool[np.ndarray, " k"] | None = None,
) -> Finding:
    """Of variables that move no output, and outputs that no variable moves: only those weigh that should.

    Args:
      bodies: outputs of the same number move together, and it says nothing if some of them do not; each alone, if None.
      untouched: says what is nearest where nothing is touched, and nothing where something is.
      kin: variables of the same number are alike, and it says nothing if some of them change nothing; each alone, if
        None.
      unused: variables that nothing reads; they weigh only where nothing else is asked for.
    """
    if lost := _dropped(slopes, differences, variables, outputs):
        return lost
    even, constant = _is_even(differences), differences.constant
    bodies, kin = (np.arange(n) if some is None else some for n, some in zip(slopes.shape, (bodies, kin), strict=True))
    still, unmoved = (slopes == 0).all(axis=0), (slopes == 0).all(axis=1)
    # Of its kind another one matters.
    is_known = np.array([not still[kin == one].all() for one in kin])
    read_by_none = still & is_known & (False if unused is None else unused)
    at_rest = still & ~read_by_none & even.any(axis=0) & (even | constant).all(axis=0)
    idle = still & ~read_by_none & is_known & constant.all(axis=0)
    weighs = still & ~(read_by_none | at_rest | idle)
    if weighs.any():
        why, remedy = _why(bool(constant[:, weighs].all()), untouched)
        sentence = f"{weighs.sum()} of {still.size} derivatives are zero ({_listed(variables, weighs)}): {why}"
        return Finding("zeros", Level.CARE, sentence, float(weighs.sum()), remedy)
    reasons = ((read_by_none, "nothing reads it"), (at_rest, "stationary here"), (idle, "no effect here"))
    told = "; ".join(f"{_listed(variables, some)} ({why})" for some, why in reasons if some.any())
    told = told and f"{still.sum()} of {still.size} derivatives are rightly zero: {told}"
    unmoved &= ~(even.any(axis=1) & (even | constant).all(axis=1))
    return _outputs(unmoved, constant, outputs, bodies, untouched, told)


def cancelled(
    slopes: Float[np.ndarray, "m k"], differences: Sweep, value: Float[np.ndarray, " m"], variables: Sequence[str]
) -> Finding | None:
    """Of variables that move what follows from them: where that undoes all they do, as a mass does in free fall, the
    derivative is what rounding leaves of zero, and nothing can be compared with it."""
    size, least = np.linalg.norm(value), np.linalg.norm(differences.central, axis=(1, 2)).min()
    largest = float(np.linalg.norm(slopes))
    if not 0 < largest <= ROUNDED * size or least > UNRESOLVED * size:
        return None
    names = _listed(variables, np.ones(len(variables), bool))
    sentence = f"what follows from {names} undoes what it does: the derivative is zero but for rounding ({largest:.0e})"
    return Finding("zeros", Level.FINE, sentence, largest)


def _dropped(
    slopes: np.ndarray, differences: Sweep, variables: Sequence[str], outputs: Sequence[str]
) -> Finding | None:
    """What is zero by autodiff alone."""
    steps = (differences.steps >= SHORTEST) & (differences.steps <= SHORT)
    size = np.abs(differences.central[steps])
    for names, axis in ((variables, 0), (outputs, 1)):
        moves = (slopes == 0).all(axis=axis) & _is_slope(size.max(axis=axis + 1))
        if moves.any():
            sentence = f"{_listed(names, moves)}: autodiff says zero, but differences do not"
            remedy = "the code drops this derivative: of mjx.step differentiate tog.step; look for stop_gradient, "
            return Finding("zeros", Level.FAULT, sentence, float(moves.sum()), remedy + "argmax, round")
    return None


def _outputs(
    unmoved: Bool[np.ndarray, " m"],
    constant: Bool[np.ndarray, "m k"],
    outputs: Sequence[str],
    bodies: Int[np.ndarray, " m"],
    untouched: Callable[[], str],
    told: str,
) -> Finding:
    """Of outputs that nothing moves, where all variables move what they should; `told` is what is known of those."""
    if not unmoved.any():
        return Finding(
            "zeros", Level.FINE, told or "each variable moves some output, and each output is moved by some", 0.0
        )
    left = np.array([unmoved[bodies == body].all() for body in bodies])
    shown = left if left.any() else unmoved
    what = f"no variable moves {_listed(outputs, shown)} ({shown.sum()} of {len(shown)} outputs)"
    if not left.any():
        sentence = f"{told}; {what}" if told else what
        return Finding("zeros", Level.FINE, f"{sentence}, but others of the same body move", float(shown.sum()))
    why, remedy = _why(bool(constant[left].all()), untouched)
    return Finding("zeros", Level.CARE, f"{what}: {why}", float(shown.sum()), remedy)


def _is_even(differences: Sweep) -> Bool[np.ndarray, "m k"]:
    """Where a value moves over every long step, and the less the shorter it is: its slope goes to zero, and yet it is
    not flat."""
    long = differences.steps >= LONG
    size = np.maximum(np.abs(differences.ahead), np.abs(differences.behind))[long]
    if len(size) < 2:
        return np.zeros(differences.constant.shape, bool)
    order = np.argsort(differences.steps[long])
    return (size > 0).all(axis=0) & (size[order[0]] <= FALLS * size[order[-1]])


def _is_slope(size: Float[np.ndarray, "H n"]) -> Bool[np.ndarray, " n"]:
    return (size.min(axis=0) >= STEADY * size.max(axis=0)) & (size.min(axis=0) > 0)


def _why(is_constant: bool, untouched: Callable[[], str]) -> tuple[str, str]:
    """Of what stays the same over every step or not, and the remedy."""
    if not is_constant:
        remedy = "begin where it moves, or average over perturbations: the estimators tell over which"
        return "the output moves with longer steps only: this piece of it is flat", remedy
    if why := untouched():
        return why, "start nearer, run longer, or perturb until something touches: no gradient points there"
    return (
        f"the output does not change over steps of up to {STEPS.max():.0%} of a variable's size",
        "begin elsewhere, as nothing may be touched from here, or run longer; or check that the input is wired to the "
        "output",
    )


def _listed(names: Sequence[str], chosen: Bool[np.ndarray, " n"]) -> str:
    """The first few of the names chosen."""
    some = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    return ", ".join(some[:3]) + (", ..." if len(some) > 3 else "")
