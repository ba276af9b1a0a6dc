"""The types that all estimators share."""

from collections.abc import Callable

from jaxtyping import Array, Float, Key

from tog_mjx.running.types import Scalar

Objective = Callable[[Float[Array, " n"]], Scalar]
"""J: decision variables to cost."""

Estimator = Callable[[Key[Array, ""], Float[Array, " n"]], tuple[Float[Array, ""], Float[Array, " n"]]]
"""(key, u) to (J(u), an estimate of its gradient)."""
