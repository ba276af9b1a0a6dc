"""MJX's integrators, with the derivative that rotation has at zero angular velocity.

The values are MJX's own (RK4's, whose stages are called here, up to rounding). Two derivatives are not:

- Quaternions. A free or ball joint advances by q (x) exp(dt omega / 2). MJX computes it through omega / |omega| and
  returns a zero derivative at omega = 0, without a warning; the true one is dt / 2 in each axis. Here the rotation is
  written in functions of |omega|^2, which are smooth at zero.
- RK4. MJX's stages call its own solver, so they are called here on the differentiable `forward`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from tog_mjx.running.errors import InputError
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.safe import cos_sinc, with_derivative_of

Forward = Callable[[mjx.Model, mjx.Data], mjx.Data]


def integrate(model: mjx.Model, data: mjx.Data, forward: Forward) -> mjx.Data:
    """The state one time step after `data`, on which `forward` has been called.

    Raises:
      InputError: for an integrator that MJX's JAX implementation lacks.
    """
    match model.opt.integrator:
        case mjx.IntegratorType.EULER:
            after = mjx.euler(model, data)
        case mjx.IntegratorType.IMPLICITFAST:
            after = mjx.implicit(model, data)
        case mjx.IntegratorType.RK4:
            return _runge_kutta_4(model, data, forward)
        case other:
            raise InputError(
                f"integrator {other} is not one of MJX's; set <option integrator> to Euler, implicitfast or RK4"
            )
    qpos = positions_after(model, data.qpos, model.opt.timestep * after.qvel)
    return after.replace(qpos=with_derivative_of(after.qpos, qpos))


def positions_after(
    model: mjx.Model | mujoco.MjModel, qpos: Float[Array, " nq"], change: Float[Array, " nv"]
) -> Float[Array, " nq"]:
    """Positions displaced by `change`, a velocity times a duration."""
    pieces = []
    for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
        if kind == mjx.JointType.FREE:
            pieces += [qpos[q : q + 3] + change[v : v + 3], rotated(qpos[q + 3 : q + 7], change[v + 3 : v + 6])]
        elif kind == mjx.JointType.BALL:
            pieces.append(rotated(qpos[q : q + 4], change[v : v + 3]))
        else:
            pieces.append(qpos[q : q + 1] + change[v : v + 1])
    return jnp.concatenate(pieces) if pieces else qpos


def rotated(quaternion: Float[Array, "4"], angle: Float[Array, "3"]) -> Float[Array, "4"]:
    """A quaternion (w, x, y, z), turned by a rotation vector in its own frame and normalised."""
    cos, sinc = cos_sinc(angle @ angle / 4)
    turn = jnp.concatenate([cos[None], sinc * angle / 2])
    w, v = quaternion[0], quaternion[1:]
    product = jnp.concatenate([(w * turn[0] - v @ turn[1:])[None], w * turn[1:] + turn[0] * v + jnp.cross(v, turn[1:])])
    return product / jnp.linalg.norm(product)


def _coast(model: mjx.Model, data: mjx.Data, qvel: Float[Array, " nv"]) -> mjx.Data:
    """MJX's own advance of positions, activations and time, at a given velocity and without acceleration."""
    plain = model.opt.disableflags | mjx.DisableBit.EULERDAMP
    model = model.replace(opt=model.opt.replace(disableflags=plain))
    after = mjx.euler(model, data.replace(qvel=qvel, qacc=jnp.zeros_like(data.qacc)))
    return after.replace(
        qpos=with_derivative_of(after.qpos, positions_after(model, data.qpos, model.opt.timestep * qvel))
    )


def _runge_kutta_4(model: mjx.Model, data: mjx.Data, forward: Forward) -> mjx.Data:
    """The classical explicit method: stages at 0, 1/2, 1/2 and 1, weighted 1/6, 1/3, 1/3 and 1/6."""
    start, dt = data, model.opt.timestep
    slopes = (data.qvel, data.qacc, data.act_dot)
    total = jax.tree.map(lambda slope: slope / 6, slopes)

    def stage(carry, scheme):
        total, data, (qvel, qacc, act_dot) = carry
        fraction, weight = scheme
        state = {
            "qpos": _coast(model, start, fraction * qvel).qpos,
            "qvel": start.qvel + fraction * qacc * dt,
            "act": start.act + fraction * act_dot * dt,
            "time": start.time + fraction * dt,
        }
        data = forward(model, data.replace(**state))
        slopes = (data.qvel, data.qacc, data.act_dot)
        return (jax.tree.map(lambda sum_, slope: sum_ + weight * slope, total, slopes), data, slopes), None

    schemes = (jnp.array([0.5, 0.5, 1.0]), jnp.array([1 / 3, 1 / 3, 1 / 6]))
    (total, data, _), _ = jax.lax.scan(stage, (total, data, slopes), schemes)
    qvel, qacc, act_dot = total
    after = _coast(model, start.replace(act_dot=act_dot), qvel)
    moved = {"qpos": after.qpos, "act": after.act, "time": after.time}
    return data.replace(**moved, qvel=start.qvel + qacc * dt, qacc_warmstart=data.qacc)
