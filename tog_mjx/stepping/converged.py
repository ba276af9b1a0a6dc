"""Solver settings under which the motion is the scene's, and not the solver's."""

import copy
from typing import TypeVar

import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from tog_mjx.running.errors import require_kind
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.simulate import simulate

Model = TypeVar("Model", mjx.Model, mujoco.MjModel)
ITERATIONS, LINE_SEARCH, TOLERANCE = 100, 50, 1e-10
"""MuJoCo's own numbers at least. The tolerance is one of the cost, quadratic in the acceleration: MuJoCo's 1e-8 may
leave an error of 1e-4 where Newton's method still closes in slowly."""


def converged(model: Model) -> Model:
    """The model with a solver that goes on until it has converged: Newton's method, and iterations enough.

    It costs nothing where the solver had converged before, and elsewhere the iterations that were missing. By how much
    the motion changes `solver_error` says. A mujoco.MjModel is copied.

    Raises:
      InputError: for anything but an mjx.Model or a mujoco.MjModel.
    """
    if isinstance(model, mjx.Model):
        options = {name: max(getattr(model.opt, name), least) for name, least in _LEAST.items()}
        newton, tolerance = mjx.SolverType.NEWTON, jnp.minimum(model.opt.tolerance, TOLERANCE)
        return model.replace(opt=model.opt.replace(solver=newton, tolerance=tolerance, **options))
    require_kind("the model", model, mujoco.MjModel, "give an mjx.Model or a mujoco.MjModel")
    model = copy.copy(model)
    for name, least in _LEAST.items():
        setattr(model.opt, name, max(getattr(model.opt, name), least))
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.tolerance = min(model.opt.tolerance, TOLERANCE)
    return model


_LEAST = {"iterations": ITERATIONS, "ls_iterations": LINE_SEARCH}


def solver_error(
    model: mjx.Model, data: mjx.Data, controls: Float[Array, "*shape nu"], steps: int
) -> Float[Array, " nq"]:
    """How far each position [nq] strays along a motion from that of `converged(model)`, at most.

    Raises:
      InputError: as `tog.simulate`, whose arguments it takes, without a batch.

    Units: of each position: m, rad, or parts of a quaternion.
    Gradient: none is meant to be taken of a largest difference.
    Source: own.
    """
    given, right = (
        simulate(some, data, controls, steps, observe=lambda data: data.qpos)[1] for some in (model, converged(model))
    )
    return jnp.abs(given - right).max(0)
