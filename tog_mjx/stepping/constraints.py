"""MuJoCo's constraint force as one pure function of the constraint-space acceleration.

A row with x = J q - a_ref and regulariser D = 1 / R exerts, by its kind,

- equality: -D x;
- friction loss, up to the loss F: -D x, clipped to [-F, F];
- limit, frictionless contact, edge of a pyramidal cone: -D x where x < 0, else 0;
- elliptic contact: the rows of one contact together, see `_elliptic_force`.

This is minus the gradient of the solver's convex cost. It is written anew because the solver's own version is tangled
up with its iterations and has no safe derivative at zero sliding speed.

Source: MuJoCo documentation, Computation, "Primal problem".
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Bool, Float

from tog_mjx.running.errors import InputError
from tog_mjx.stepping._mjx import constraint_rows, contacts, mjx
from tog_mjx.stepping.safe import safe_norm

_NEWTON_STEPS = 20
"""Two or three are usual."""


def _static():
    return dataclasses.field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Rows:
    """The constraint rows of a state: equalities first, then friction losses, then limits and contacts.

    `jacobian` [nefc, nv], `reference` (a_ref), `D` and `friction_loss` [nefc]. `elliptic` lists the groups (condim,
    number of contacts) of elliptic contacts, which are the last rows, and `friction` [K, 5] holds the coefficients of
    those K contacts; `condims` are those of all contacts; `impratio` [] is MuJoCo's ratio of frictional to normal
    impedance. Arrays are leaves (annotated Any, as JAX puts other things in their place), numbers of rows are static.
    """

    jacobian: Any
    reference: Any
    D: Any
    friction_loss: Any
    friction: Any
    impratio: Any
    equalities: int = _static()
    losses: int = _static()
    elliptic: tuple[tuple[int, int], ...] = _static()
    condims: tuple[int, ...] = dataclasses.field(default=(), metadata={"static": True})

    def at(self, qacc: Float[Array, " nv"]) -> Float[Array, " nefc"]:
        """x = J q - a_ref at the acceleration q."""
        return self.jacobian @ qacc - self.reference


def require_jax(model: mjx.Model, data: mjx.Data) -> None:
    """Raises InputError for a model or data that is not on MJX's JAX implementation."""
    if not model.impl == data.impl == mjx.Impl.JAX:
        raise InputError(
            f"the model is on MJX's {model.impl.value} implementation and the data on its {data.impl.value} one; "
            'implicit differentiation needs mjx.put_model(model, impl="jax") and mjx.make_data(model, impl="jax")'
        )


def read_rows(model: mjx.Model, data: mjx.Data) -> Rows:
    """The constraint rows that `mjx.fwd_position` left in `data`."""
    rows, touching = constraint_rows(data), contacts(data)
    dim = touching.condim
    is_elliptic = (dim > 1) & (model.opt.cone == mjx.ConeType.ELLIPTIC)
    condims, counts = np.unique(dim[is_elliptic], return_counts=True)
    # MJX sorts contacts by condim, and puts their rows last and in that order.
    assert (np.diff(dim) >= 0).all()
    return Rows(
        jacobian=rows.jacobian,
        reference=rows.reference,
        D=rows.D,
        friction_loss=rows.friction_loss,
        friction=touching.friction[np.flatnonzero(is_elliptic)],
        impratio=jnp.asarray(model.opt.impratio),
        equalities=rows.equalities,
        losses=rows.losses,
        elliptic=tuple(zip(condims.tolist(), counts.tolist(), strict=True)),
        condims=tuple(dim.tolist()),
    )


def masked(rows: Rows, keep: Bool[Array, " nefc"]) -> Rows:
    """The rows with those not kept made void, as MJX does with rows that do not act."""
    return dataclasses.replace(
        rows, jacobian=jnp.where(keep[:, None], rows.jacobian, 0.0), reference=jnp.where(keep, rows.reference, 0.0)
    )


def some_of(which: Bool[Array, " nefc"], rows: Rows, others: Rows) -> Rows:
    """Some of the rows from one set, and the rest from another one."""
    return dataclasses.replace(
        others,
        jacobian=jnp.where(which[:, None], rows.jacobian, others.jacobian),
        reference=jnp.where(which, rows.reference, others.reference),
        D=jnp.where(which, rows.D, others.D),
    )


def constraint_force(rows: Rows, x: Float[Array, " nefc"]) -> Float[Array, " nefc"]:
    """The force [nefc] of all rows at x = J q - a_ref. At a kink its gradient is that of one side, or between both."""
    scalar, elliptic = _split(rows)
    forces = [_scalar_force(rows, x[scalar])]
    for group, condim, friction in elliptic:
        kernel = jax.vmap(_elliptic_force, (0, 0, 0, None))
        forces.append(kernel(_fold(x[group], condim), _fold(rows.D[group], condim), friction, rows.impratio).ravel())
    return jnp.concatenate(forces)


def constraint_hessian(rows: Rows, x: Float[Array, " nefc"]) -> Float[Array, "nv nv"]:
    """-J^T (df/dx) J at x = J q - a_ref: a block for each elliptic contact, a number for each other row."""
    scalar, elliptic = _split(rows)
    _, slope = jax.jvp(lambda x: _scalar_force(rows, x), (x[scalar],), (jnp.ones_like(x[scalar]),))
    hessian = -rows.jacobian[scalar].T @ (slope[:, None] * rows.jacobian[scalar])
    for group, condim, friction in elliptic:
        kernel = jax.vmap(jax.jacfwd(_elliptic_force), (0, 0, 0, None))
        slopes = kernel(_fold(x[group], condim), _fold(rows.D[group], condim), friction, rows.impratio)
        jacobian = _fold(rows.jacobian[group], condim)
        hessian -= jnp.einsum("kiv,kij,kjw->vw", jacobian, slopes, jacobian)
    return hessian


def residual(
    qacc: Float[Array, " nv"], mass: Float[Array, "nv nv"], qfrc_smooth: Float[Array, " nv"], rows: Rows
) -> Float[Array, " nv"]:
    """M q - f_smooth - J^T f(J q - a_ref): the gradient of the solver's convex cost, zero at its solution."""
    return mass @ qacc - qfrc_smooth - rows.jacobian.T @ constraint_force(rows, rows.at(qacc))


def solution(
    start: Float[Array, " nv"], mass: Float[Array, "nv nv"], qfrc_smooth: Float[Array, " nv"], rows: Rows
) -> Float[Array, " nv"]:
    """The acceleration at which the residual is zero, from one that is near; not for differentiation.

    Newton's method. Where a whole step leaves the cost steeper than half of what it was, on the other side of a kink,
    the step is cut where a line through both slopes is zero. MJX's solver searches longer, at five times the price.
    """
    enough = jnp.finfo(start.dtype).eps ** 0.75

    def is_moving(state: tuple) -> Array:
        count, q, step = state
        return (count < _NEWTON_STEPS) & (jnp.abs(step).max() > enough * (1 + jnp.abs(q).max()))

    def advance(state: tuple) -> tuple:
        count, q, _ = state
        gradient = residual(q, mass, qfrc_smooth, rows)
        step = -cho_solve(cho_factor(mass + constraint_hessian(rows, rows.at(q))), gradient)
        before, after = step @ gradient, step @ residual(q + step, mass, qfrc_smooth, rows)
        is_long = after > -0.5 * before  # Which is negative.
        step *= jnp.where(is_long, before / jnp.where(is_long, before - after, 1.0), 1.0)
        return count + 1, q + step, step

    return jax.lax.while_loop(is_moving, advance, (0, start, jnp.full_like(start, jnp.inf)))[1]


Group = tuple[slice, int, Float[Array, "count tangential"]]


def _split(rows: Rows) -> tuple[slice, list[Group]]:
    """The scalar rows, and for each group of elliptic contacts its rows, condim and friction coefficients."""
    row = rows.D.shape[0] - sum(condim * count for condim, count in rows.elliptic)
    scalar, contact, groups = slice(0, row), 0, []
    for condim, count in rows.elliptic:
        friction = rows.friction[contact : contact + count, : condim - 1]
        groups.append((slice(row, row + condim * count), condim, friction))
        row, contact = row + condim * count, contact + count
    return scalar, groups


def _fold(x: Array, condim: int) -> Array:
    """Rows [count * condim, ...], contact by contact: [count, condim, ...]."""
    return x.reshape(-1, condim, *x.shape[1:])


def _scalar_force(rows: Rows, x: Float[Array, " scalar"]) -> Float[Array, " scalar"]:
    """The force of the rows that know nothing of each other: all but those of elliptic contacts."""
    n = x.shape[0]
    linear, loss, index = -rows.D[:n] * x, rows.friction_loss[:n], np.arange(n)
    force = jnp.where(
        index < rows.equalities + rows.losses, jnp.clip(linear, -loss, loss), jnp.where(x < 0, linear, 0.0)
    )
    return jnp.where(index < rows.equalities, linear, force)


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
