"""C MuJoCo as the reference: the cost of many setpoints at a time, and its gradient by central differences."""

import functools
from collections.abc import Iterator

import jax
import mujoco
import mujoco.rollout
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.rollout import interpolate
from tog_mjx.gradients.settled import Differences, central_differences, halvings
from tog_mjx.paper.tasks import Task
from tog_mjx.running.devices import cores
from tog_mjx.stepping.mjx_state import default_start

STEPS = halvings(1e-6, 9)
"""Of setpoints, in m: beyond the first a jump of the cost is often in between, before the last rounding shows."""
SETTLED = 1e-4
"""The largest relative change at the last halving with which a gradient counts as known."""


def final_costs(task: Task, setpoints: Float[np.ndarray, "N n"], threads: int | None = None) -> Float[np.ndarray, " N"]:
    """J of each row of setpoints, on all cores or as many threads as given."""
    model = task.scene.model
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, default_start(model), start, kind)
    box = np.concatenate([1 + task.scene.joints[:3], 1 + model.nq + task.scene.joints[:3]])
    workers = [mujoco.MjData(model) for _ in range(threads or cores())]
    last = []
    for chunk in np.array_split(setpoints, -(-len(setpoints) // 256)):
        controls = np.zeros((len(chunk), 1 if task.knots == 1 else task.horizon - 1, model.nu))
        controls[:, :, task.scene.actuators] = chunk[:, None] if task.knots == 1 else _tables(task, chunk)
        initial = np.tile(start, (len(chunk), 1))
        states, _ = mujoco.rollout.rollout(model, workers, initial, control=controls, nstep=task.horizon - 1)
        last.append(states[:, -1, box])
    with jax.enable_x64():
        return np.asarray(jax.vmap(task.cost)(np.concatenate(last)))


def _tables(task: Task, setpoints: Float[np.ndarray, "N n"]) -> np.ndarray:
    """The setpoints [N, steps, 2F] of every time step, from those of the knots."""
    with jax.enable_x64():
        return np.asarray(jax.vmap(functools.partial(interpolate, task))(setpoints))


def gradients(task: Task, setpoints: Float[np.ndarray, "N n"], chunk: int = 25) -> Iterator[Differences]:
    """dJ/du by central differences, a chunk of setpoints at a time: Jacobians [chunk, 1, n] and their changes."""
    for first in range(0, len(setpoints), chunk):
        points = setpoints[first : first + chunk]
        yield central_differences(lambda u: final_costs(task, np.asarray(u))[:, None], points, STEPS)
