"""A gradient in float32, JAX's default, against the one in float64."""

import numpy as np
from jaxtyping import Float

from tog_mjx.checks.agreement import relative
from tog_mjx.checks.finding import Finding, Level

SLIGHT, GRAVE = 0.01, 0.5
"""Relative errors that are told, and that leave nothing of the gradient."""


def judge_single(double: Float[np.ndarray, "m k"], single: Float[np.ndarray, "m k"]) -> Finding:
    remedy = "use float64: jax.config.update('jax_enable_x64', True)"
    if not np.isfinite(single).all():
        return Finding("precision", Level.FAULT, "in float32, JAX's default, the gradient is not finite", None, remedy)
    error = relative(double, single)
    sentence = f"in float32, JAX's default, the gradient differs by {error:.0e} from that in float64"
    if error <= SLIGHT:
        return Finding("precision", Level.FINE, sentence, error)
    return Finding("precision", Level.FAULT if error > GRAVE else Level.CARE, sentence, error, remedy)
