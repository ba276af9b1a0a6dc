"""Which variables have the derivative zero, and why: nothing touched, not wired, or dropped by the code."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from tog_mjx.checks.agreement import Sweep
from tog_mjx.checks.finding import Finding, Level

SHORT = 1e-4
"""Differences over shorter steps than this, relative to the variables' scale, see the same piece as the gradient."""


def zeros(
    slopes: Float[np.ndarray, "m k"],
    differences: Sweep,
    names: Sequence[str],
    untouched: Callable[[], str] = lambda: "",
) -> Finding:
    """`untouched` says what is nearest where nothing is touched, and nothing where something is."""
    absent = ~slopes.any(axis=0)
    if not absent.any():
        return Finding("zeros", Level.FINE, "no variable has the derivative zero", 0.0)
    moves = absent & (np.abs(differences.central[differences.steps <= SHORT]).max(axis=(0, 1)) > 0)
    if moves.any():
        sentence = f"{_listed(names, moves)}: autodiff says zero, but differences do not"
        remedy = (
            "the code drops this derivative: of mjx.step differentiate tog.step; look for stop_gradient, argmax, round"
        )
        return Finding("zeros", Level.FAULT, sentence, float(moves.sum()), remedy)
    if (absent & ~differences.constant).any():
        why, remedy = (
            "the output moves with longer steps only: this piece of it is flat",
            "average over perturbations: tog_mjx.gradients",
        )
    elif why := untouched():
        remedy = "start nearer, run longer, or perturb until something touches: no gradient points there"
    else:
        why, remedy = "the output does not depend on it", "check that the input is wired to the output"
    sentence = f"{absent.sum()} of {absent.size} derivatives are zero ({_listed(names, absent)}): {why}"
    return Finding("zeros", Level.CARE, sentence, float(absent.sum()), remedy)


def _listed(names: Sequence[str], chosen: Any) -> str:
    """The first few of the names chosen."""
    some = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    return ", ".join(some[:3]) + (", ..." if len(some) > 3 else "")
