"""Vectors of the plane as pairs of numbers.

A vector is a pytree of its two components, so that a simulator written in vectors computes with single numbers: under
`vmap` each becomes one array over the batch, and XLA can fuse a whole time step. Small arrays would be gathered,
concatenated and sliced again and again, which took three times as long.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from tog_mjx.running.types import AnyArray

Number = Any
"""A scalar array or a float."""


class Plane(NamedTuple):
    """A vector (x, z). Angles are counter-clockwise, in rad."""

    x: Number
    z: Number

    @classmethod
    def of(cls, pair: AnyArray) -> "Plane":
        return cls(pair[0], pair[1])

    def __add__(self, other: "Plane") -> "Plane":  # type: ignore[override]
        return Plane(self.x + other.x, self.z + other.z)

    def __sub__(self, other: "Plane") -> "Plane":
        return Plane(self.x - other.x, self.z - other.z)

    def __mul__(self, factor: Number) -> "Plane":
        return Plane(self.x * factor, self.z * factor)

    def __neg__(self) -> "Plane":
        return Plane(-self.x, -self.z)

    def dot(self, other: "Plane") -> Any:
        return self.x * other.x + self.z * other.z

    def cross(self, other: "Plane") -> Any:
        """The counter-clockwise torque of the force `other` with this lever arm."""
        return self.x * other.z - self.z * other.x

    def turned(self, angle: Number) -> "Plane":
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        return Plane(cos * self.x - sin * self.z, sin * self.x + cos * self.z)

    def perpendicular(self) -> "Plane":
        """Turned by a right angle: the velocity of that point under unit angular speed."""
        return Plane(-self.z, self.x)
