"""MuJoCo's constraint force as one pure function of the constraint-space acceleration.

A row with x = J q - a_ref and regulariser D = 1 / R exerts, by its kind,

- equality: -D x;
- friction loss, up to the loss F: -D x, clipped to [-F, F];
- limit, frictionless contact, edge of a pyramidal cone: -D x where x < 0, else 0;
- elliptic contact: the rows of one contact together, see `_elliptic_force`.

This is minus the gradient of the solver's convex cost. It is written anew because the solver's own version is tangled
up with its iterations and has no safe derivative at zero sliding speed. Only `read_rows` touches what MJX keeps
private.

Source: MuJoCo documentation, Computation, "Primal problem".
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx._mjx import mjx
from tog_mjx.errors import InputError
from tog_mjx.safe import safe_norm


class Rows(NamedTuple):
    """The constraint rows of a state: equalities first, then friction losses, then limits and contacts.

    `friction` [K, 5] holds the coefficients of the K elliptic contacts, whose condim and first row are static;
    `impratio` is MuJoCo's ratio of frictional to normal impedance.
    """

    jacobian: Float[Array, "nefc nv"]
    reference: Float[Array, " nefc"]
    D: Float[Array, " nefc"]
    friction_loss: Float[Array, " nefc"]
    friction: Float[Array, "K 5"]
    impratio: Float[Array, ""]
    equalities: int
    losses: int
    elliptic: tuple[tuple[int, int], ...]


def require_jax(model: mjx.Model, data: mjx.Data) -> None:
    """Raises InputError for a model or data that is not on MJX's JAX implementation."""
    if not model.impl == data.impl == mjx.Impl.JAX:
        raise InputError(
            f"the model is on MJX's {model.impl.value} implementation and the data on its {data.impl.value} one; "
            'implicit differentiation needs mjx.put_model(model, impl="jax") and mjx.make_data(model, impl="jax")'
        )


def read_rows(model: mjx.Model, data: mjx.Data) -> Rows:
    """The constraint rows that `mjx.fwd_position` left in `data`."""
    impl = data._impl
    dim, address = np.asarray(impl.contact.dim), np.asarray(impl.contact.efc_address)
    is_elliptic = (dim > 1) & (model.opt.cone == mjx.ConeType.ELLIPTIC)
    return Rows(
        jacobian=impl.efc_J,
        reference=impl.efc_aref,
        D=impl.efc_D,
        friction_loss=impl.efc_frictionloss,
        friction=impl.contact.friction[np.flatnonzero(is_elliptic)],
        impratio=jnp.asarray(model.opt.impratio),
        equalities=int(impl.ne),
        losses=int(impl.nf),
        elliptic=tuple(zip(dim[is_elliptic].tolist(), address[is_elliptic].tolist(), strict=True)),
    )


def constraint_force(rows: Rows, x: Float[Array, " nefc"]) -> Float[Array, " nefc"]:
    """The force [nefc] of all rows at x = J q - a_ref. At a kink its gradient is that of one side, or between both."""
    linear = -rows.D * x
    index = np.arange(x.shape[0])
    clipped = jnp.clip(linear, -rows.friction_loss, rows.friction_loss)
    force = jnp.where(index < rows.equalities + rows.losses, clipped, jnp.where(x < 0, linear, 0.0))
    force = jnp.where(index < rows.equalities, linear, force)
    for condim in sorted({condim for condim, _ in rows.elliptic}):
        contacts = [i for i, (dim, _) in enumerate(rows.elliptic) if dim == condim]
        adr = np.array([range(rows.elliptic[i][1], rows.elliptic[i][1] + condim) for i in contacts])
        friction = rows.friction[np.array(contacts), : condim - 1]
        kernel = jax.vmap(_elliptic_force, (0, 0, 0, None))
        force = force.at[adr].set(kernel(x[adr], rows.D[adr], friction, rows.impratio))
    return force


def _elliptic_force(
    x: Float[Array, " condim"],
    D: Float[Array, " condim"],
    friction: Float[Array, " tangential"],
    impratio: Float[Array, ""],
) -> Float[Array, " condim"]:
    """The force of one elliptic contact, x = (normal, tangential...).

    With mu = friction_1 / sqrt(impratio), scale n = mu x_n and t_i = friction_i x_i, whose length is t. Above the cone
    (n >= mu t) the force is zero; below its polar (mu n + t <= 0) it is -D x; between them the cost is s = D_c (n - mu
    t)^2 / 2 with D_c = D_n / (mu^2 (1 + mu^2)), and the force minus its gradient. At the apex and at zero tangential
    speed the force and its gradient are those of the outer regions, where t does not enter.
    """
    mu = friction[0] / jnp.sqrt(impratio)
    n, scaled = mu * x[0], friction * x[1:]
    t = safe_norm(scaled)
    is_above, is_below = n >= mu * t, mu * n + t <= 0
    slip = D[0] / (mu**2 * (1 + mu**2)) * (n - mu * t)
    direction = scaled / jnp.where(t == 0, 1.0, t)
    between = mu * slip * jnp.concatenate([-jnp.ones(1), friction * direction])
    return jnp.where(is_above, 0.0, jnp.where(is_below, -D * x, between))
