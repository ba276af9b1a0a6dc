"""What the randomised estimators share: their directions, and the check of their settings."""

import jax
from jaxtyping import Array, Float, Key

from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Scalar

Size = float | Scalar
"""A number, or an array of one number, which may be traced."""


def directions(key: Key[Array, ""], u: Float[Array, " n"], samples: int) -> Float[Array, "N n"]:
    """N draws of N(0, I): times sigma they are perturbations w of u. One key gives all estimators the same."""
    return jax.random.normal(key, (samples, u.size), u.dtype)


def check_positive(name: str, value: Size, reason: str) -> None:
    """Refuse a size known to be wrong. Of a traced one nothing is known.

    Raises:
      InputError: for a value that is not positive and finite.
    """
    if not isinstance(value, jax.core.Tracer) and not 0 < float(value) < float("inf"):
        raise InputError(f"{name} is {value}: {reason}")


def check_sigma(sigma: Size) -> None:
    """As `check_positive`, of a standard deviation."""
    check_positive("sigma", sigma, "the perturbation needs a positive standard deviation")


def check_samples(samples: int, least: int = 1) -> None:
    """Refuse fewer than `least` samples.

    Raises:
      InputError: for too few.
    """
    if samples < least:
        raise InputError(f"samples is {samples}: the estimate needs at least {least}")
