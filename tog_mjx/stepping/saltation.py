"""What touch-downs and partings add to the derivative of a step of MJX: `stepping.touch` for MuJoCo's constraints.

A limit or a contact acts while its gap is negative. Of those within the box of their switch, with the force f_c that
would act if they were at the surface, the acceleration moves by

    dq = H^-1 J_c^T f_c ds_c,    ds_c = -d(gap_c) / w_c,    H = M - J^T (df/dx) J of all other rows.

Where the others stay on one piece of their law, H^-1 (sum over c of J_c^T f_c) is the acceleration with all of them
minus that without any, exactly: contacts that switch together are counted once. Where the others do not (a hit makes
slide what the floor held), that difference is taken, and what it has more is shared out among the switches.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from tog_mjx.stepping._mjx import contacts, mjx, with_margins
from tog_mjx.stepping.constraints import (
    Rows,
    constraint_force,
    constraint_hessian,
    masked,
    read_rows,
    solution,
    some_of,
)
from tog_mjx.stepping.safe import safe_norm
from tog_mjx.stepping.touch import box_width


class Effects(NamedTuple):
    """What the switches s [S] move: of the accelerations dq/ds [nv, S], and of the rows' forces df/ds [nefc, S]."""

    qacc: Float[Array, "nv S"]
    force: Float[Array, "nefc S"]


def gaps(model: mjx.Model, data: mjx.Data) -> Float[Array, " S"]:
    """How far each limit and contact is from acting [m or rad], in the order of MJX's rows; negative where it acts."""
    joints, found = _limited_joints(model), []
    for ball, chosen in zip((True, False), joints, strict=True):
        for i in chosen:
            q, (low, high) = int(model.jnt_qposadr[i]), model.jnt_range[i]
            if ball:
                angle = 2 * jnp.arctan2(safe_norm(data.qpos[q + 1 : q + 4]), data.qpos[q])
                distance = jnp.maximum(low, high) - jnp.abs(jnp.where(angle > jnp.pi, angle - 2 * jnp.pi, angle))
            else:
                distance = jnp.minimum(data.qpos[q] - low, high - data.qpos[q])
            found.append(distance - model.jnt_margin[i])
    for i in _limited_tendons(model):
        length, (low, high) = data.ten_length[i], model.tendon_range[i]
        found.append(jnp.minimum(length - low, high - length) - model.tendon_margin[i])
    touching = contacts(data)
    return jnp.concatenate([jnp.array(found).reshape(-1), touching.distance - touching.margin])


def effects(
    model: mjx.Model,
    data: mjx.Data,
    mass: Float[Array, "nv nv"],
    qacc: Float[Array, " nv"],
    rows: Rows,
    gap: Float[Array, " S"],
) -> Effects:
    """Times -d(gap), what the switches add to the derivatives; zero where none is in its box.

    `data` is that of `mjx.fwd_acceleration`, `qacc` and `rows` the solution and its rows.
    """
    normals, owns = map(jnp.asarray, _normals(model, rows))
    open_ = gap >= 0
    # As if all touched just now: in MJX, rows that are open are masked, and those that act do so at the depth reached.
    surface = read_rows(model, _at_surface(model, data, gap))
    closed = some_of(owns.T @ open_ > 0, surface, rows)
    force = constraint_force(closed, closed.at(qacc))
    normal = normals @ closed.jacobian
    pushed = cho_solve(cho_factor(mass), normal.T)
    pull = jnp.einsum("sr,r,rv->sv", owns, force, closed.jacobian)
    kick = jnp.einsum("sv,vs->s", pull, pushed)
    # An open one is not in the solution yet, and would give way to its own force.
    yielding = jnp.einsum("sv,vs->s", normal, pushed) * ((normals != 0) @ closed.D)
    kick = jnp.where(open_, kick / (1 + yielding), kick)
    width = box_width(normal @ data.qvel, kick, model.opt.timestep)
    near = (jnp.abs(gap) <= width / 2) & (width > 0)

    def found() -> Effects:
        is_near = owns.T @ near > 0
        # The force at the surface on both sides of it: at the depth reached it would err to one side.
        with_all, without = some_of(is_near, surface, rows), masked(rows, ~is_near)

        def solved(some: Rows) -> tuple[Array, Array]:
            acceleration = solution(qacc, mass, data.qfrc_smooth, some)
            return acceleration, constraint_force(some, some.at(acceleration))

        both = jax.tree.map(lambda *some: jnp.stack(some), with_all, without)
        (qacc_with, qacc_without), (force, force_without) = jax.vmap(solved)(both)
        own = owns.T * force[:, None] * near
        x = without.at(qacc_without)
        parts = cho_solve(cho_factor(mass + constraint_hessian(without, x)), with_all.jacobian.T @ own)
        others = jax.vmap(
            lambda dq: jax.jvp(lambda x: constraint_force(without, x), (x,), (without.jacobian @ dq,))[1], 1, 1
        )(parts)
        qacc_parts = _adding_up(parts, qacc_with - qacc_without, near)
        force_parts = jnp.where(is_near[:, None], own, _adding_up(others, force - force_without, near))
        slope = jnp.where(near, -1 / jnp.where(near, width, 1.0), 0.0)
        return Effects(qacc_parts * slope, force_parts * slope)

    nothing = Effects(jnp.zeros((model.nv, gap.size), qacc.dtype), jnp.zeros((rows.D.size, gap.size), qacc.dtype))
    return jax.lax.cond(near.any(), found, lambda: nothing)


def _adding_up(parts: Float[Array, "n S"], total: Float[Array, " n"], near: Array) -> Float[Array, "n S"]:
    """The parts, with what the total has more than all of them shared out by their squares, each number by itself."""
    squares = parts**2
    sums = squares.sum(1, keepdims=True)
    shares = jnp.where(sums > 0, squares / jnp.where(sums > 0, sums, 1.0), near / near.sum())
    return parts + shares * (total - parts.sum(1))[:, None]


def _at_surface(model: mjx.Model, data: mjx.Data, gap: Float[Array, " S"]) -> mjx.Data:
    """The data with the rows of limits and contacts that all touch just now, by margins as large as their gaps."""
    ball, plain = _limited_joints(model)
    tendons, order = _limited_tendons(model), np.concatenate([ball, plain])
    wider = gap + jnp.finfo(gap.dtype).eps ** 0.75
    joint, tendon = len(order), len(tendons)
    return with_margins(
        model,
        data,
        model.jnt_margin.at[order].add(wider[:joint]),
        model.tendon_margin.at[tendons].add(wider[joint : joint + tendon]),
        contacts(data).margin + wider[joint + tendon :],
    )


def _normals(model: mjx.Model, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """For each switch [S, nefc]: the weights of the rows that make up its normal, and which rows are its own."""
    is_elliptic = model.opt.cone == mjx.ConeType.ELLIPTIC
    limits = len(_limited_tendons(model)) + sum(map(len, _limited_joints(model)))
    sizes = [(1, 1)] * limits
    for condim in rows.condims:
        edges = 2 * (condim - 1)
        sizes.append((1, 1) if condim == 1 else (condim, 1) if is_elliptic else (edges, edges))
    normals = np.zeros((len(sizes), rows.D.size), rows.D.dtype)
    owns = np.zeros_like(normals)
    row = rows.equalities + rows.losses
    for i, (size, of_normal) in enumerate(sizes):
        owns[i, row : row + size] = 1
        normals[i, row : row + of_normal] = 1 / of_normal
        row += size
    return normals, owns


def _limited_joints(model: mjx.Model) -> tuple[np.ndarray, np.ndarray]:
    """Ball joints, then slides and hinges, that have limits."""
    if model.opt.disableflags & mjx.DisableBit.LIMIT:
        return np.zeros(0, int), np.zeros(0, int)
    is_ball, limited = model.jnt_type == mjx.JointType.BALL, np.asarray(model.jnt_limited, bool)
    is_plain = np.isin(model.jnt_type, (mjx.JointType.SLIDE, mjx.JointType.HINGE))
    return np.flatnonzero(is_ball & limited), np.flatnonzero(is_plain & limited)


def _limited_tendons(model: mjx.Model) -> np.ndarray:
    if model.opt.disableflags & mjx.DisableBit.LIMIT:
        return np.zeros(0, int)
    return np.flatnonzero(model.tendon_limited)
