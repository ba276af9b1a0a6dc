"""Which variables and outputs have derivatives of zero, and why: nothing touched, not wired, or dropped by the code."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from tog_mjx.checks.agreement import Sweep
from tog_mjx.checks.finding import Finding, Level

SHORTEST, SHORT = 0.9e-6, 1.1e-4
"""Steps of differences, relative to the variables' scale, that see the same piece as the gradient, and are not yet
drowned by rounding."""
STEADY = 0.5
"""Of the largest slope over these steps the least: a slope that is there is the same over all of them. What curvature
makes of it falls by 100 times or more as they shrink, what rounding makes of it grows."""


def zeros(
    slopes: Float[np.ndarray, "m k"],
    differences: Sweep,
    variables: Sequence[str],
    outputs: Sequence[str],
    bodies: Int[np.ndarray, " m"] | None = None,
    untouched: Callable[[], str] = lambda: "",
) -> Finding:
    """Of variables that move no output, and outputs that no variable moves.

    Args:
      bodies: outputs of the same number move together, and it says nothing if some of them do not; each alone, if None.
      untouched: says what is nearest where nothing is touched, and nothing where something is.
    """
    steps = (differences.steps >= SHORTEST) & (differences.steps <= SHORT)
    size = np.abs(differences.central[steps])
    still, unmoved = (slopes == 0).all(axis=0), (slopes == 0).all(axis=1)
    for names, absent, axis in ((variables, still, 1), (outputs, unmoved, 2)):
        moves = absent & _is_slope(size.max(axis=axis))
        if moves.any():
            sentence = f"{_listed(names, moves)}: autodiff says zero, but differences do not"
            remedy = "the code drops this derivative: of mjx.step differentiate tog.step; look for stop_gradient, "
            return Finding("zeros", Level.FAULT, sentence, float(moves.sum()), remedy + "argmax, round")
    if still.any():
        why, remedy = _why(bool((differences.constant | ~still).all()), untouched, "it")
        sentence = f"{still.sum()} of {still.size} derivatives are zero ({_listed(variables, still)}): {why}"
        return Finding("zeros", Level.CARE, sentence, float(still.sum()), remedy)
    if not unmoved.any():
        return Finding("zeros", Level.FINE, "each variable moves some output, and each output is moved by some", 0.0)
    bodies = np.arange(len(unmoved)) if bodies is None else bodies
    left = np.array([unmoved[bodies == body].all() for body in bodies])
    shown = left if left.any() else unmoved
    told = f"no variable moves {_listed(outputs, shown)} ({shown.sum()} of {len(shown)} outputs)"
    if not left.any():
        return Finding("zeros", Level.FINE, f"{told}, but others of the same body move", float(shown.sum()))
    why, remedy = _why(bool((differences.constant | ~left[:, None]).all()), untouched, "them")
    return Finding("zeros", Level.CARE, f"{told}: {why}", float(shown.sum()), remedy)


def _is_slope(size: Float[np.ndarray, "H n"]) -> Bool[np.ndarray, " n"]:
    return (size.min(axis=0) >= STEADY * size.max(axis=0)) & (size.min(axis=0) > 0)


def _why(is_constant: bool, untouched: Callable[[], str], cause: str) -> tuple[str, str]:
    """Of what stays the same over every step or not, and the remedy."""
    if not is_constant:
        remedy = "average over perturbations: tog_mjx.gradients"
        return "the output moves with longer steps only: this piece of it is flat", remedy
    if why := untouched():
        return why, "start nearer, run longer, or perturb until something touches: no gradient points there"
    return f"the output does not depend on {cause}", "check that the input is wired to the output"


def _listed(names: Sequence[str], chosen: Bool[np.ndarray, " n"]) -> str:
    """The first few of the names chosen."""
    some = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    return ", ".join(some[:3]) + (", ..." if len(some) > 3 else "")
