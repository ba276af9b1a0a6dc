"""Shapes, named once. Plane vectors are (x, z); F is the number of fingers and n = 2F that of setpoints."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

AnyArray = Array | np.ndarray
Numbers = ArrayLike | Sequence[Any]
"""What a caller may give where an array is made of it."""

Scalar = Float[AnyArray, ""]
Vector = Float[AnyArray, "2"]

Box = Float[AnyArray, "6"]
"""x, z, theta, vx, vz, omega."""
Fingers = Float[AnyArray, "F 4"]
"""x, z, vx, vz of each finger."""
Setpoints = Float[AnyArray, " n"]
"""Finger-major: (x_des, z_des) of finger 1, then of finger 2, in m. Of several knots, one after the other."""
