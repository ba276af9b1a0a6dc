"""C MuJoCo as the reference: the cost of many points at a time, and its gradient by central differences."""

import functools
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.gradients.differences import Differences, halvings, settled_differences
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.state import Derived, State
from tog_mjx.running.devices import cores
from tog_mjx.running.errors import InputError

STEPS = halvings(1e-6, 9)
"""Of setpoints, in m: beyond the first a jump of the cost is often in between, before the last rounding shows."""
SETTLED = 1e-4
"""The largest relative change at the last halving with which a gradient counts as known."""
_NOTHING = Derived("the reference knows positions, velocities and activations alone")


def final_costs(problem: Problem, points: Float[np.ndarray, "N n"], threads: int | None = None) -> np.ndarray:
    """J [N] of each row of controls, on all cores or as many threads as given: for costs of the last positions,
    velocities and activations alone."""
    model = problem.scene.model
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, problem.origin, start, kind)
    workers, last = [mujoco.MjData(model) for _ in range(threads or cores())], []
    plan = problem.bound.controls
    if plan is None or callable(jax.eval_shape(plan, problem.x0)):
        raise InputError("the reference moves problems under controls over time alone")
    with jax.enable_x64():
        controls, costs = _compiled(problem)
        for chunk in np.array_split(points, -(-len(points) // 256)):
            initial, rows = np.tile(start, (len(chunk), 1)), np.asarray(controls(chunk))
            states, _ = mujoco.rollout.rollout(model, workers, initial, control=rows, nstep=problem.steps)
            last.append(states[:, -1])
        return np.asarray(costs(np.concatenate(last)))


@functools.lru_cache(maxsize=64)
def _compiled(problem: Problem) -> tuple[Callable, Callable]:
    """The controls of many points, and the costs of many last states."""
    plan, model = problem.bound.controls, problem.scene.model
    assert plan
    controls = jax.vmap(lambda x: jnp.atleast_2d(jnp.asarray(plan(x))))
    return jax.jit(controls), jax.jit(jax.vmap(lambda state: problem.cost(_state(model, state))))


def _state(model: mujoco.MjModel, numbers: Float[Array, " s"]) -> State:
    """The State behind MuJoCo's vector of a full state."""
    time, qpos, qvel, act = jnp.split(numbers, np.cumsum([1, model.nq, model.nv]))
    return State(time[0], qpos, qvel, act[: model.na], jnp.zeros(model.nu), model, _NOTHING)


def gradients(problem: Problem, points: Float[np.ndarray, "N n"], chunk: int = 25) -> Iterator[Differences]:
    """dJ/dx by central differences, a chunk of points at a time: Jacobians [chunk, 1, n] and their changes."""
    for first in range(0, len(points), chunk):
        some = points[first : first + chunk]
        yield settled_differences(lambda x: final_costs(problem, np.asarray(x))[:, None], some, STEPS)
