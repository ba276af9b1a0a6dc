"""A drop-in for `mjx.step` whose value is MJX's and whose derivative is right: implicit differentiation.

A solver that stops after a few iterations is differentiated otherwise, see `tog_mjx.stepping.unrolled`. This is about
one that has converged.

MJX's solver finds the acceleration q [nv] at which

    r(q; p) = M q - f_smooth - J^T f(J q - a_ref) = 0,

where the constraint force f also depends on the regulariser D and the friction coefficients, and everything but q
depends on the parameters p (state, controls, model). Differentiating its iterations fails: reverse mode cannot cross
their `while_loop`, and on the elliptic cone forward mode gives NaN once a contact is open. By the implicit function
theorem no iteration need be differentiated:

    dq = -H^-1 (dr/dp) dp,        H = dr/dq = M - J^T (df/dx) J,   x = J q - a_ref,

with H symmetric and positive definite, since f is minus the gradient of a convex function. The rule below states just
that, to JAX, as a Jacobian-vector product that is linear in dp: forward mode is exact and reverse mode is its
transpose. The rule's own q is this differentiable one again, so that derivatives of any order follow: those of H and of
dr/dp move with q.

Model parameters. The derivative in a field of `mjx.Model` is that of `mjx.step` with this field changed alone. What
MuJoCo's compiler derives from an MJCF attribute does not follow: a new `body_mass` leaves `body_inertia` and the
inverse weights (`body_invweight0`, `dof_invweight0`, `tendon_invweight0`), by which constraints are scaled, as they
were. These are fields too, with right derivatives: `tog.Parameter` moves them along. What the compiler left out has the
derivative zero, without a word: a friction loss or a limit that the MJCF file does not give makes no constraint row.

Source: MuJoCo documentation, Computation, "Constraint model" and "Primal problem".
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.custom_derivatives import SymbolicZero
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from tog_mjx.running.errors import require_choice
from tog_mjx.stepping._mjx import constraint_rows, mended, mjx, tendon_jacobian, with_constraint_force
from tog_mjx.stepping.constraints import Rows, constraint_force, constraint_hessian, read_rows, require_jax, residual
from tog_mjx.stepping.integration import integrate
from tog_mjx.stepping.mjx_state import require_on_mjx, require_state
from tog_mjx.stepping.safe import moved_along, with_derivative_of
from tog_mjx.stepping.saltation import effects, gaps
from tog_mjx.stepping.unrolled import doubt, is_unrolled, jvp_along, telling
from tog_mjx.stepping.unrolled import solve as solve_unrolled

Step = Callable[[mjx.Model, mjx.Data], mjx.Data]
_SOLUTION = "tog_mjx solution"


def step(model: mjx.Model, data: mjx.Data, *, differentiation: str = "implicit") -> mjx.Data:
    """Advances the simulation by one time step: same value as `mjx.step`, differentiable in both modes.

    Args:
      model, data: on MJX's JAX implementation, qpos [nq] and so on; `jax.vmap` takes batches.
      differentiation: "implicit": the gradient is that of the converged solution, or, with fewer `iterations` than
        `tog_mjx.stepping.unrolled.FEW`, that of those iterations. With more, and yet not converged, it is not that of
        the value: a warning says so where the settings tell, and `tog_mjx.converged` mends it. At the kinks of
        the contact law (stick to slip) it is one-sided, and of the jump of a touch-down it knows nothing. "saltation":
        the same, and the jumps of touch-downs and partings, of contacts and limits, averaged over where time steps fall
        (`tog_mjx.stepping.touch`). "native": stock `mjx.step`. The warm start carries a gradient only where iterations
        are differentiated.

    Raises:
      InputError: for a model that is not on MJX's JAX implementation, data of another one, or an unknown
        differentiation.

    Units: the model's, SI where it is: m, rad, kg, s.
    Gradient: in state, inputs and all floats of the model, forward and reverse, to second order. At a touch-down and a
      parting it is that of the side on which the step is, and with "saltation" holds the jump on average. A contact or
      a limit exactly at its surface does not act yet, nor has its derivative. At rest, rotations, springs, servos and
      tendons have theirs, which is zero in stock MJX. At a kink (stick to slip, friction loss) it is one side's, of a
      control exactly at the end of its range half the slope, beyond it zero.
    Source: MuJoCo's documentation, Computation, "Constraint model" and "Primal problem", and the implicit function
      theorem; the jumps: saltation matrices, Aizerman and Gantmakher 1958, Kong et al. 2024.
    """
    require_choice("differentiation", differentiation, STEPS)
    require_on_mjx(model, data)
    require_state(model, data)
    return STEPS[differentiation](model, data)


@mended()
def sensed(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """What follows from positions and velocities alone, sensors of both among it; forces are what they were."""
    require_jax(model, data)
    data = mjx.sensor_pos(model, mjx.fwd_position(model, data))
    return mjx.sensor_vel(model, _springs(model, mjx.fwd_velocity(model, data)))


@mended()
def forward(model: mjx.Model, data: mjx.Data, saltation: bool = False) -> mjx.Data:
    """`mjx.forward`, differentiable: the accelerations and forces of a state, without integration."""
    data = sensed(model, data)
    data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, data))
    rows, mass = read_rows(model, data), mjx.full_m(model, data)
    if rows.jacobian.size == 0:
        return data.replace(qacc=data.qacc_smooth)
    if is_unrolled(model):
        qacc, generalised, force = checkpoint_name(solve_unrolled(model, data), _SOLUTION)
    else:
        qacc, generalised, force = _implicit(model, data, mass, rows)
    if saltation:
        before = qacc
        qacc, force = _switched((qacc, force), gaps(model, data), (model, data, mass, rows))
        # Those of rows that are about to act are in it too.
        generalised = with_derivative_of(generalised, generalised + mass @ (qacc - before))
    data = with_constraint_force(data.replace(qacc=qacc, qfrc_constraint=generalised), force)
    return mjx.sensor_acc(model, data)


def _implicit(
    model: mjx.Model, data: mjx.Data, mass: Float[Array, "nv nv"], rows: Rows
) -> tuple[Float[Array, " nv"], Float[Array, " nv"], Float[Array, " nefc"]]:
    """The solution, the constraint forces and those of the rows: MJX's, with the derivative of the converged ones."""
    solved = jax.lax.stop_gradient(mjx.solve(*jax.lax.stop_gradient((model, data))))
    qacc = _differentiable(checkpoint_name(solved.qacc, _SOLUTION), mass, data.qfrc_smooth, rows)
    force = constraint_force(rows, rows.at(qacc))
    given = solved.qfrc_constraint, constraint_rows(solved).force
    return qacc, *with_derivative_of(given, (rows.jacobian.T @ force, force))


def _checkpointed(forward: Callable[[mjx.Model, mjx.Data], mjx.Data]) -> Step:
    # Reverse mode would store hundreds of small arrays a step. Storing the state and the solver's answer, and computing
    # the rest again on the way back, is faster, and takes a hundredth of the memory.
    policy = jax.checkpoint_policies.save_only_these_names(_SOLUTION)
    step = jax.checkpoint(
        lambda model, data: integrate(model, forward(model, data), forward), policy=policy, prevent_cse=False
    )

    def telling_step(model: mjx.Model, data: mjx.Data) -> mjx.Data:
        # Out here, as inside of a checkpoint the settings are not known.
        told, after = doubt(model), step(model, data)
        return after.replace(qvel=telling(told, after.qvel)) if told and constraint_rows(after).D.size else after

    return telling_step


FORWARDS: dict[str, Step] = {
    "implicit": forward,
    "saltation": functools.partial(forward, saltation=True),
    "native": lambda model, data: mjx.forward(model, data),
}
"""The accelerations and forces of a state, without integration, by how they are differentiated: see `step`."""
STEPS: dict[str, Step] = {
    "implicit": _checkpointed(FORWARDS["implicit"]),
    "saltation": _checkpointed(FORWARDS["saltation"]),
    "native": lambda model, data: mjx.step(model, data),
}
"""How a step is differentiated, by name: see `step`."""


def _springs(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """The same forces, with the derivatives of a tendon's spring where MJX has none.

    At its rest length, where an undeflected model is, MJX puts the force together from two sides, and takes neither at
    the point between them: it has the derivative zero. Between two sites that coincide the tendon has no direction, but
    a spring that is at rest there pulls like one in space.
    """
    off = mjx.DisableBit.SPRING | mjx.DisableBit.DAMPER  # With either MJX leaves out all passive forces.
    if model.ntendon == 0 or model.opt.disableflags & off:
        return data
    low, high = model.tendon_lengthspring.T
    stretch = jnp.where((low == high) & (data.ten_length == low), data.ten_length - low, 0.0)
    force = -tendon_jacobian(data).T @ (model.tendon_stiffness * stretch)
    for i in np.flatnonzero(model.tendon_num == 2):
        ends = model.tendon_adr[i] + np.arange(2)
        if (model.wrap_type[ends] == mjx.WrapType.SITE).all():
            sites = model.wrap_objid[ends]
            jacobians = [mjx.jac(model, data, data.site_xpos[site], model.site_bodyid[site])[0] for site in sites]
            apart = data.site_xpos[sites[1]] - data.site_xpos[sites[0]]
            pull = -model.tendon_stiffness[i] * (jacobians[1] - jacobians[0]) @ apart
            force += jnp.where((data.ten_length[i] == 0) & (high[i] == 0), pull, 0.0)
    return data.replace(qfrc_passive=with_derivative_of(data.qfrc_passive, data.qfrc_passive + force))


@jax.custom_jvp
def _differentiable(
    qacc: Float[Array, " nv"], mass: Float[Array, "nv nv"], qfrc_smooth: Float[Array, " nv"], rows: Rows
) -> Float[Array, " nv"]:
    """The solution `qacc` of r = 0, with its derivative in the inertia matrix, the smooth forces and the rows."""
    del mass, qfrc_smooth, rows
    return qacc


def _jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    solution, parameters = jax.lax.stop_gradient(primals[0]), primals[1:]
    factors = cho_factor(jax.lax.stop_gradient(_hessian(solution, *parameters)))
    # One Newton correction carries the first derivative of q, and with it the second one of what is returned. Calling
    # this function again carries all; but `scan` in reverse mode drops the rule of what it computes on the way
    # forward, and differentiates the function in its place, which passes its argument on.
    correction = -cho_solve(factors, residual(solution, *parameters))
    qacc = _differentiable(moved_along(solution, solution + correction), *parameters)
    _, residual_dot = jvp_along(functools.partial(residual, qacc), parameters, tangents[1:])
    hessian = _hessian(qacc, *parameters)
    qacc_dot = jax.lax.custom_linear_solve(
        lambda x: hessian @ x, -residual_dot, lambda _, b: cho_solve(factors, b), symmetric=True
    )
    return qacc, qacc_dot


def _hessian(
    qacc: Float[Array, " nv"], mass: Float[Array, "nv nv"], qfrc_smooth: Float[Array, " nv"], rows: Rows
) -> Float[Array, "nv nv"]:
    """dr/dq, symmetric to the last bit."""
    del qfrc_smooth
    hessian = mass + constraint_hessian(rows, rows.at(qacc))
    return (hessian + hessian.T) / 2


_differentiable.defjvp(_jvp, symbolic_zeros=True)


@jax.custom_jvp
def _switched(moved: tuple[Array, Array], gap: Float[Array, " S"], where: tuple) -> tuple[Array, Array]:
    """Accelerations and rows' forces as they are, with what switches of limits and contacts add to the derivative."""
    del gap, where
    return moved


@functools.partial(_switched.defjvp, symbolic_zeros=True)
def _(primals: tuple, tangents: tuple) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    (qacc, force), gap, (model, data, mass, rows) = primals
    qacc_dot, force_dot = (
        jnp.zeros(dot.shape, dot.dtype) if isinstance(dot, SymbolicZero) else dot for dot in tangents[0]
    )
    if not isinstance(tangents[1], SymbolicZero):
        of_switches = effects(*jax.lax.stop_gradient((model, data, mass, qacc, rows, gap)))
        qacc_dot, force_dot = qacc_dot + of_switches.qacc @ tangents[1], force_dot + of_switches.force @ tangents[1]
    return (qacc, force), (qacc_dot, force_dot)
