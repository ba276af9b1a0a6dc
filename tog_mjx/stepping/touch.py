"""The derivative of a contact's switch, which autodiff leaves out.

A contact acts with s f, where s = 1 while the bodies overlap (dist < 0) and 0 while they are apart. The force f does
not begin at zero: at the moment of touch its damper is on at once. So the motion in discrete time jumps wherever a
touch-down, or a parting, falls on another time step, and the derivative between two jumps is not the slope of what is
simulated, however small the time step. Here s keeps its value and has the derivative of a box about the surface,

    ds = -d(dist) / w    where  |dist| <= w / 2,    else 0,

    w = max(|v_n| dt, 4 a_n dt^2),

with v_n the normal speed, and a_n the normal acceleration of the bodies towards or from each other by f.

- A body that crosses the surface at speed has exactly one step in a box as wide as |v_n| dt, wherever steps lie,
  before the surface or behind it. Averaged over where they lie, the jump is counted once, with the force at the surface
  and with what follows on both sides of the jump: that is the saltation matrix, to second order in dt.
- A body that hovers at the surface, as MuJoCo's friction lets a sliding contact do, is thrown back by each step of
  contact: it travels a_n dt in one step, however slowly it crosses, and boxes narrower than this kick would be entered
  again and again with ever larger quotients, until gradients explode. Within a box of four kicks the derivative is
  that of a spring, dv = -(a_n / w) d(dist) dt, with a period of 4 pi time steps at least: bounded for any motion that
  stays within two kicks of the surface.

Sources: saltation matrices: Aizerman and Gantmakher 1958; Kong et al. 2024.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tog_mjx.running.types import AnyArray, Scalar

KICKS = 4.0
"""Width of the box, in distances by which one time step of the contact's force moves the bodies. With 2, gradients
through contacts that hover are bounded too, but up to ten times too large; with 8 the smoothing shows."""


def box_width(
    normal_speed: Float[AnyArray, "*s"], normal_acceleration: Float[AnyArray, "*s"], timestep: Scalar | float
) -> Float[Array, "*s"]:
    """w [m] from v_n [m/s], a_n [m/s^2] and dt [s], each of any sign. Its own gradient is not taken."""
    travel, kick = jnp.abs(normal_speed) * timestep, jnp.abs(normal_acceleration) * timestep**2
    return jax.lax.stop_gradient(jnp.maximum(travel, KICKS * kick))


@jax.custom_jvp
def switch(distance: Scalar, width: Scalar) -> Scalar:
    """1 where bodies overlap (distance [m] < 0), else 0; with the derivative of a box of that width [m] in distance."""
    return jnp.where(distance < 0, jnp.ones_like(width), 0.0)


@switch.defjvp
def _jvp(primals: tuple, tangents: tuple) -> tuple[Scalar, Scalar]:
    distance, width = primals
    # Selected before the division, so that no quotient is infinite where nothing moves.
    is_inside = (jnp.abs(distance) <= width / 2) & (width > 0)
    slope = jnp.where(is_inside, -1 / jnp.where(is_inside, width, 1.0), 0.0)
    return switch(distance, width), slope * tangents[0]
