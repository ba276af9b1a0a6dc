"""One step of both tasks from 10,000 random states each: the derivative is that of C MuJoCo's differences.

The states are drawn around contact: one corner near the floor, fingers near the box's faces and corners, some deep in
it, all moving. C MuJoCo itself says which contacts stick, slide or part.
"""

import collections
import copy
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import mujoco.rollout
import numpy as np
import pytest

from tog_mjx.engines import MjxSimulator, make_simulator
from tog_mjx.gradients.differences import Differences, halvings, settled_differences
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.running.devices import cores

STATES = 10_000
TOLERANCE = 1e-5
LEFT_OUT = {"flip": 0, "grasp": 2}
"""States not within it."""
SHARES = {
    "flip": {"free": 18, "sticking": 56, "sliding": 15, "parting": 31, "corner": 3},
    "grasp": {"free": 6, "sticking": 73, "sliding": 22, "parting": 45, "corner": 6, "two fingers": 32},
}
"""Of the states, in per cent; these and the above are what the README says."""


class Study(NamedTuple):
    """x [STATES, 2 nv + nu]: positions, velocities, setpoints. Jacobians of the next positions and velocities."""

    task: Task
    x: np.ndarray
    found: np.ndarray
    expected: Differences
    error: np.ndarray


def draw(task: Task) -> np.ndarray:
    rng = np.random.default_rng(11)
    p, fingers = task.scene.physics, len(task.scene.fingers)
    theta = rng.uniform(-np.pi, np.pi, STATES) * rng.choice([0.05, 1], STATES)
    cos, sin = np.cos(theta), np.sin(theta)
    lowest = (sin[:, None] * p.corners[:, 0] + cos[:, None] * p.corners[:, 1]).min(1)
    box = np.stack([rng.normal(size=STATES), rng.uniform(-0.02, 0.02, STATES) - lowest, theta], axis=1)
    positions, velocities = [box], [rng.normal(size=(STATES, 3)) * rng.choice([0.02, 1, 3], (STATES, 1))]
    for _ in range(fingers):
        # A point of the box's outline, and from there outwards; every fifth finger is at a corner.
        along = rng.uniform(-1, 1, STATES)
        along = np.where(rng.random(STATES) < 0.2, np.sign(along) * rng.uniform(0.97, 1.05, STATES), along)
        depth = 1 + (p.finger_radius + rng.uniform(-0.04, 0.03, STATES)) / p.box_half[0]
        local = p.box_half[0] * np.stack([depth, along], axis=1)
        turns = rng.integers(0, 4, STATES) * np.pi / 2 + theta
        c, s = np.cos(turns), np.sin(turns)
        offset = np.stack([c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]], axis=1)
        positions.append(box[:, :2] + offset)
        velocities.append(velocities[0][:, :2] + rng.normal(size=(STATES, 2)) * rng.choice([0.02, 1, 3], (STATES, 1)))
    setpoints = rng.uniform(-1, 1, (STATES, 2 * fingers))
    return np.concatenate([*positions, *velocities, setpoints], axis=1)


def converged(task: Task) -> mujoco.MjModel:
    model = copy.copy(task.scene.model)
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    return model


def step_in_c(task: Task, x: np.ndarray) -> np.ndarray:
    model, nv = converged(task), task.scene.model.nv
    order = task.scene.joints
    state = np.zeros((len(x), 1 + 2 * nv))
    state[:, 1 + order], state[:, 1 + nv + order] = x[:, :nv], x[:, nv : 2 * nv]
    controls = np.zeros((len(x), 1, model.nu))
    controls[:, 0, task.scene.actuators] = x[:, 2 * nv :]
    workers = [mujoco.MjData(model) for _ in range(cores())]
    after, _ = mujoco.rollout.rollout(model, workers, state, control=controls, nstep=1)
    return np.concatenate([after[:, 0, 1 + order], after[:, 0, 1 + nv + order]], axis=1)


def regimes(task: Task, x: np.ndarray) -> frozenset:
    """The contacts of a state and what each does: (geom, geom, kind, direction of the normal in the box's frame)."""
    model, nv = task.scene.model, task.scene.model.nv
    data = mujoco.MjData(model)
    data.qpos[task.scene.joints], data.qvel[task.scene.joints] = x[:nv], x[nv : 2 * nv]
    data.ctrl[task.scene.actuators] = x[2 * nv :]
    mujoco.mj_forward(model, data)
    c, s = np.cos(x[2]), np.sin(x[2])
    found = []
    for contact in data.contact[: data.ncon]:
        normal_force, *tangential = data.efc_force[contact.efc_address : contact.efc_address + 3]
        slides = np.linalg.norm(tangential) > (1 - 1e-9) * contact.friction[0] * normal_force
        kind = "parting" if normal_force == 0 else "sliding" if slides else "sticking"
        normal = contact.frame[0] * c + contact.frame[2] * s, contact.frame[2] * c - contact.frame[0] * s
        is_box = model.geom("box").id in contact.geom
        found.append((*map(int, contact.geom), kind, tuple(np.round(normal, 2).tolist()) if is_box else ()))
    return frozenset(found)


@pytest.fixture(scope="module", params=["flip", "grasp"])
def study(request) -> Study:
    task = get_task(request.param)
    x, nv = draw(task), task.scene.model.nv
    simulator = make_simulator("mjx", task.scene)
    assert isinstance(simulator, MjxSimulator)
    order = jnp.array(task.scene.joints)

    def step(x: jax.Array) -> jax.Array:
        start = simulator.init(*task.scene.start)
        moved = {"qpos": start["qpos"].at[order].set(x[:nv]), "qvel": start["qvel"].at[order].set(x[nv : 2 * nv])}
        after = simulator.step(start | moved, x[2 * nv :])
        return jnp.concatenate([after["qpos"][order], after["qvel"][order]])

    run = jax.jit(jax.vmap(jax.jacfwd(step)))
    found = np.concatenate([np.asarray(run(jnp.asarray(part))) for part in np.split(x, 10)])
    parts = [
        settled_differences(lambda x: step_in_c(task, np.asarray(x)), part, halvings(4e-6, 4))
        for part in np.split(x, 10)
    ]
    expected = Differences(*(np.concatenate(field) for field in zip(*parts, strict=True)))
    size = np.linalg.norm(expected.jacobian, axis=(1, 2))
    return Study(task, x, found, expected, np.linalg.norm(found - expected.jacobian, axis=(1, 2)) / size)


def test_every_derivative_is_finite(study):
    assert np.isfinite(study.found).all()


def test_all_are_within_tolerance_of_the_differences_or_straddle_a_kink(study):
    # Within the differences' steps the contacts change what they do, or the nearest face or corner of the box changes.
    nv, directions = study.task.scene.model.nv, np.eye(study.x.shape[1])
    rest = np.flatnonzero(study.error > TOLERANCE)
    assert len(rest) == LEFT_OUT[study.task.name]
    for i in rest:
        here = regimes(study.task, study.x[i])
        shifted = [study.x[i] + sign * 4e-6 * d for d in directions for sign in (1, -1)]
        assert any(regimes(study.task, x) != here for x in shifted), (i, study.error[i], study.x[i, : 2 * nv])


def test_the_states_are_of_the_kinds_that_the_readme_says(study):
    shares: collections.Counter = collections.Counter()
    box = study.task.scene.model.geom("box").id
    for x in study.x:
        found = regimes(study.task, x)
        presses = [contact for contact in found if box in contact[:2]]
        shares.update({contact[2] for contact in found} or {"free"})
        shares["two fingers"] += len(presses) == 2
        shares["corner"] += any(0.01 < abs(n) < 0.99 for *_, normal in presses for n in normal)
    assert {kind: round(100 * shares[kind] / STATES) for kind in SHARES[study.task.name]} == SHARES[study.task.name]
