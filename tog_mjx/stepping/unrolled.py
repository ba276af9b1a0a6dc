"""The derivative of a solver that stops early: that of its iterations.

Implicit differentiation gives the derivative of the converged solution, which the value is not where `iterations` is
small, as it is in the models of reinforcement learning (1 to 8 iterations). There what the solver does is
differentiated, line search and warm start included: the derivative is that of the value, at the price of going through
few iterations again.
"""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import jax
import mujoco
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from tog_mjx.stepping._mjx import constraint_rows, mjx
from tog_mjx.stepping._unrolled import unrolled_solve
from tog_mjx.stepping.safe import Tree, with_derivative_of

FEW = {int(mujoco.mjtSolver.mjSOL_NEWTON): 10, int(mujoco.mjtSolver.mjSOL_CG): 20}
"""Solvers of fewer iterations are unrolled. Newton's method takes two or three where its start is good, conjugate
gradients some ten, and more where contacts come and go."""
SHORT_SEARCH, LOOSE = 5, 1e-6
"""Solvers of fewer steps of line search, or of a larger tolerance, may stop before they have converged, too."""
Solved = tuple[Array, Array, Array]


def is_unrolled(model: mjx.Model) -> bool:
    """Whether the solver's iterations are differentiated, and not the solution that they approach."""
    return model.opt.iterations < FEW[model.opt.solver]


def solve(model: mjx.Model, data: mjx.Data) -> Solved:
    """`mjx.solve`, differentiable: the acceleration [nv], its constraint forces [nv] and those of the rows [nefc]."""
    # No rule of its own: in a batch JAX must see the solver's conditions before it differentiates them, as it cannot go
    # back through the tangents of a `cond` whose condition is batched afterwards.
    value = mjx.solve(*jax.lax.stop_gradient((model, data)))
    return with_derivative_of(_of(value), _of(unrolled_solve(model, data)))


def doubt(model: mjx.Model) -> str:
    """What of the settings may leave the solver unconverged though it is not unrolled, with the remedy; or nothing."""
    option, doubts = model.opt, []
    if is_unrolled(model):
        return ""
    if option.ls_iterations < SHORT_SEARCH:
        doubts.append(f"ls_iterations={option.ls_iterations}")
    if not isinstance(option.tolerance, jax.core.Tracer) and (loose := np.asarray(option.tolerance).max()) > LOOSE:
        doubts.append(f"tolerance={loose:g}")
    if not doubts:
        return ""
    told = f"with {', '.join(doubts)} the solver may stop before it has converged, and derivatives are not the value's"
    return f"{told}; simulate tog_mjx.converged(model)"


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def telling(told: str, x: Tree) -> Tree:
    """`x`; whoever differentiates it is warned."""
    del told
    return x


@telling.defjvp
def _(told: str, primals: tuple[Tree], tangents: tuple[Tree]) -> tuple[Tree, Tree]:
    warnings.warn(told, stacklevel=2)
    return primals[0], tangents[0]


def _of(data: mjx.Data) -> Solved:
    return data.qacc, data.qfrc_constraint, constraint_rows(data).force


def jvp_along(function: Callable[..., Any], primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    """`jax.jvp` of `function` along those tangents that are not known to be zero."""
    leaves, tree = jax.tree.flatten(primals)
    dots = jax.tree.leaves(tangents, is_leaf=lambda dot: isinstance(dot, SymbolicZero))
    moving = [i for i, dot in enumerate(dots) if not isinstance(dot, SymbolicZero)]

    def of_moving(values: list[Array]) -> Any:
        given = dict(zip(moving, values, strict=True))
        return function(*jax.tree.unflatten(tree, [given.get(i, leaf) for i, leaf in enumerate(leaves)]))

    return jax.jvp(of_moving, ([leaves[i] for i in moving],), ([dots[i] for i in moving],))
