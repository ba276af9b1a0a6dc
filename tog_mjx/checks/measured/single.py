"""A gradient in float32, JAX's default, against the one in float64."""

import numpy as np
from jaxtyping import Float

from tog_mjx.checks.measured.agreement import relative
from tog_mjx.checks.told.finding import Finding, Level

SLIGHT = 0.01
"""Relative error that is told: less costs no descent anything, and is what 1e-7 becomes on a motion of many steps."""
GRAVE = 0.5
"""A gradient of which half is rounding is a fault, as one of which half is the time step's: rounding differs from point
to point, so that no step along it can be compared with the next."""


def judge_single(
    double: Float[np.ndarray, "m k"], single: Float[np.ndarray, "m k"], full: Float[np.ndarray, "m k"] | None = None
) -> Finding:
    """The gradient in float32 against that in float64.

    `full` is the one in float32 with matrix products that keep all of it: by default accelerators round their factors
    to ten bits or fewer.
    """
    remedy = "use float64: jax.config.update('jax_enable_x64', True)"
    if not np.isfinite(single).all():
        return Finding("precision", Level.FAULT, "in float32, JAX's default, the gradient is not finite", None, remedy)
    error = relative(double, single)
    sentence = f"in float32, JAX's default, the gradient differs by {error:.0e} from that in float64"
    if full is not None:
        at_best = relative(double, full)
        sentence += f", and by {at_best:.0e} with full matrix products"
        if at_best <= SLIGHT:
            remedy = "keep float32 in matrix products: jax.config.update('jax_default_matmul_precision', 'highest')"
    if error <= SLIGHT:
        return Finding("precision", Level.FINE, sentence, error)
    return Finding("precision", Level.FAULT if error > GRAVE else Level.CARE, sentence, error, remedy)
