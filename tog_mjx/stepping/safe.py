"""Singular mathematics with a defined gradient, in one place."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

Tree = TypeVar("Tree")


def moved_along(value: Tree, differentiable: Tree) -> Tree:
    """The first argument's value, to the bit, with the second one's derivative; they are equal up to rounding."""
    held = jax.lax.stop_gradient
    return jax.tree.map(lambda v, d: held(v) + (d - held(d)), value, differentiable)


@jax.custom_jvp
def with_derivative_of(value: Tree, differentiable: Tree) -> Tree:
    """The same, and where nothing is differentiated the second argument is not computed.

    Not for use in rules of derivatives: `scan` in reverse mode drops the rules of what it computes on the way forward,
    this one as well, and second derivatives would be lost.
    """
    del differentiable
    return value


@with_derivative_of.defjvp
def _(primals: tuple[Tree, Tree], tangents: tuple[Tree, Tree]) -> tuple[Tree, Tree]:
    return moved_along(*primals), tangents[1]


def regular(function: Callable[[Array], Array], low: float, high: float) -> Callable[[Array], Array]:
    """A function of one number, to the bit, with the derivative zero outside of (low, high): there it has none.

    A value that is not selected must not be infinitely steep: reverse mode multiplies that by zero.
    """

    def of(x: Array) -> Array:
        is_inside = (low < x) & (x < high)
        inside = function(jnp.where(is_inside, x, 0.5))
        return jnp.where(is_inside, inside, jax.lax.stop_gradient(function(x)))

    return of


sqrt, arcsin, arccos = (
    regular(jnp.sqrt, 0.0, np.inf),
    regular(jnp.arcsin, -1.0, 1.0),
    regular(jnp.arccos, -1.0, 1.0),
)


@jax.custom_jvp
def quotient(x: Array | float, y: Array) -> Array:
    """x / y, to the bit. JAX's derivative in y has y^-2 in it, which overflows in float32 where y is below 1e-19."""
    return x / y


@quotient.defjvp
def _(primals: tuple[Array | float, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (x, y), (x_dot, y_dot) = primals, tangents
    ratio = quotient(x, y)
    return ratio, (x_dot - ratio * y_dot) / y


def safe_norm(x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean norm over the last axis. At the zero vector it returns zero, and its gradient there is zero."""
    return sqrt(jnp.sum(x * x, axis=-1))


def cos_sinc(squared: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """cos(a) and sin(a) / a from a^2, smooth at zero: there they are 1, with derivatives -1/2 and -1/6 in a^2."""
    # Below 1 by their series, whose first terms left out are below 1e-18: derivatives of the closed forms cancel there,
    # the second ones to 1e-16 / a^4.
    is_small = squared < 1
    small, angle = jnp.where(is_small, squared, 0.0), jnp.sqrt(jnp.where(is_small, 1.0, squared))
    cos, sinc = (
        functools.reduce(lambda rest, k: 1 - rest * small / (k * (k + 1)), range(last, 0, -2), jnp.ones_like(small))
        for last in (17, 18)
    )
    return jnp.where(is_small, cos, jnp.cos(angle)), jnp.where(is_small, sinc, jnp.sin(angle) / angle)


def rotation_vector(quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """The axis times the angle [rad], in (-pi, pi], of a unit quaternion (w, x, y, z); smooth where nothing turns."""
    w, v = quaternion[0], quaternion[1:]
    sine = safe_norm(v)
    # 2 atan(t) / s with t = s / w; below 1e-3 by its series, of which the first term left out is below 1e-18.
    is_small = sine < 1e-3 * jnp.abs(w)
    t = jnp.where(is_small, (v @ v) / jnp.where(is_small, w, 1.0) ** 2, 0.0)
    series = 2 / jnp.where(is_small, w, 1.0) * (1 - t * (1 / 3 - t * (1 / 5 - t / 7)))
    angle = 2 * jnp.arctan2(jnp.where(is_small, 1.0, sine), w)
    angle = jnp.where(angle > jnp.pi, angle - 2 * jnp.pi, angle)
    return v * jnp.where(is_small, series, angle / jnp.where(is_small, 1.0, sine))


def impedance(solimp: Float[Array, "5"], violation: Float[Array, ""]) -> Float[Array, ""]:
    """MuJoCo's d(r) of `solimp` (d0, d_width, width, midpoint, power), differentiable in all of them.

    No power is taken of a negative number, and no bound is clipped that d(r) keeps by itself: there MJX's derivative is
    NaN in reverse mode, or half. Source: MuJoCo documentation, Modeling, "Solver parameters".
    """
    least, most = mujoco.mjMINIMP, mujoco.mjMAXIMP
    d0, d1, mid = (jnp.clip(solimp[i], least, most) for i in (0, 1, 3))
    width, power = jnp.maximum(mujoco.mjMINVAL, solimp[2]), jnp.maximum(1, solimp[4])
    x = jnp.where(violation < 0, -violation, violation) / width  # At zero an even power has its second derivative.
    is_low, is_within = x < mid, x < 1
    base = jnp.where(is_low, x, 0.5) + jnp.finfo(x.dtype).tiny  # No power has an infinite derivative.
    low = base**power / mid ** (power - 1)
    high = 1 - jnp.where(is_within, 1 - x, 0.5) ** power / (1 - mid) ** (power - 1)
    rise = jnp.where(is_low, low, jnp.where(is_within, high, 1.0))
    return jnp.where(d0 <= d1, d0 + rise * (d1 - d0), d1)
