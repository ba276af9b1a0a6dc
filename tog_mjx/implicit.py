"""A drop-in for `mjx.step` whose value is MJX's and whose derivative is right: implicit differentiation.

MJX's solver finds the acceleration q [nv] at which

    r(q; p) = M q - f_smooth - J^T f(J q - a_ref) = 0,

where the constraint force f also depends on the regulariser D and the friction coefficients, and everything but q
depends on the parameters p (state, controls, model). Differentiating its iterations fails: reverse mode cannot cross
their `while_loop`, and on the elliptic cone forward mode gives NaN once a contact is open. By the implicit function
theorem no iteration need be differentiated:

    dq = -H^-1 (dr/dp) dp,        H = dr/dq = M - J^T (df/dx) J,   x = J q - a_ref,

with H symmetric and positive definite, since f is minus the gradient of a convex function. The rule below states just
that, to JAX, as a Jacobian-vector product that is linear in dp: forward mode is exact and reverse mode is its
transpose.

Source: MuJoCo documentation, Computation, "Constraint model" and "Primal problem".
"""

import jax
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from tog_mjx._mjx import mjx
from tog_mjx.constraints import Rows, constraint_force, read_rows, require_jax
from tog_mjx.integration import integrate


def step(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Advances the simulation by one time step: same signature and value as `mjx.step`, differentiable in both modes.

    The gradient is that of the converged solution, whatever the number of iterations that the solver took; with an
    unconverged solver it is not the gradient of the value. At the kinks of the contact law (touch-down, stick to slip)
    it is one-sided. The warm start carries no gradient.

    Raises:
      InputError: for a model that is not on MJX's JAX implementation.
    """
    return integrate(model, forward(model, data), forward)


def forward(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """`mjx.forward`, differentiable: the accelerations and forces of a state, without integration."""
    require_jax(model, data)
    data = mjx.sensor_pos(model, mjx.fwd_position(model, data))
    data = mjx.sensor_vel(model, mjx.fwd_velocity(model, data))
    data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, data))
    if read_rows(model, data).jacobian.size == 0:
        return data.replace(qacc=data.qacc_smooth)
    qacc, qfrc_constraint, efc_force = _solve(model, data)
    data = data.tree_replace({"qacc": qacc, "qfrc_constraint": qfrc_constraint, "_impl.efc_force": efc_force})
    return mjx.sensor_acc(model, data)


Solution = tuple[Float[Array, " nv"], Float[Array, " nv"], Float[Array, " nefc"]]


@jax.custom_jvp
def _solve(model: mjx.Model, data: mjx.Data) -> Solution:
    """MJX's own solution: qacc, the constraint force in joint space, and in constraint space."""
    data = mjx.solve(model, data)
    return data.qacc, data.qfrc_constraint, data._impl.efc_force


@_solve.defjvp
def _solve_jvp(primals: tuple, tangents: tuple) -> tuple[Solution, Solution]:
    model, data = primals
    solution = _solve(model, data)
    qacc = solution[0]

    def residual_at(model: mjx.Model, data: mjx.Data, qacc: Float[Array, " nv"]):
        rows = read_rows(model, data)
        force = constraint_force(rows, rows.jacobian @ qacc - rows.reference)
        return mjx.mul_m(model, data, qacc) - data.qfrc_smooth - rows.jacobian.T @ force

    def forces_at(model: mjx.Model, data: mjx.Data, qacc: Float[Array, " nv"]):
        rows = read_rows(model, data)
        force = constraint_force(rows, rows.jacobian @ qacc - rows.reference)
        return rows.jacobian.T @ force, force

    hessian = mjx.full_m(model, data) + _constraint_hessian(read_rows(model, data), qacc)
    _, residual_dot = jax.jvp(lambda m, d: residual_at(m, d, qacc), primals, tangents)
    qacc_dot = -cho_solve(cho_factor((hessian + hessian.T) / 2), residual_dot)
    _, force_dots = jax.jvp(forces_at, (model, data, qacc), (*tangents, qacc_dot))
    return solution, (qacc_dot, *force_dots)


def _constraint_hessian(rows: Rows, qacc: Float[Array, " nv"]) -> Float[Array, "nv nv"]:
    """-J^T (df/dx) J, column by column."""

    def joint_force(qacc: Float[Array, " nv"]) -> Float[Array, " nv"]:
        return rows.jacobian.T @ constraint_force(rows, rows.jacobian @ qacc - rows.reference)

    return -jax.jacfwd(joint_force)(qacc)
