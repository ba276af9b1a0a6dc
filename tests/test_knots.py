"""Setpoints that change over time: linear between knots, and with one knot the paper's, bit for bit."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.running.errors import InputError

RAMP = np.array([0.0, 0.25, 0.2, 0.4, 0.1, 0.8])
"""Three knots of the flip."""


def plan(task: tog.Task) -> np.ndarray:
    """The setpoints of each time step."""
    assert task.bound.controls
    return np.asarray(task.bound.controls(jnp.array(RAMP)))


def test_setpoints_are_linear_between_evenly_spaced_knots():
    task = tog.get_task("flip", knots=3)
    table = plan(task)
    knots = RAMP.reshape(3, 2)
    assert table.shape == (599, 2)
    np.testing.assert_array_equal(table[[0, 299, 598]], knots)
    times = np.linspace(0, 2, 599)
    for axis in (0, 1):
        np.testing.assert_allclose(table[:, axis], np.interp(times, [0, 1, 2], knots[:, axis]), atol=1e-15)


@pytest.mark.parametrize("simulator", ["penalty", "released"])
def test_one_knot_is_the_paper_and_equal_knots_are_constant(simulator):
    one, four = tog.get_task("grasp", knots=1), tog.get_task("grasp", knots=4)
    assert one is tog.get_task("grasp")
    u = np.array([-0.1, 0.4, 0.15, 0.5])
    constant, tiled = (tog.rollout(task, v, simulator) for task, v in ((one, u), (four, np.tile(u, 4))))
    np.testing.assert_allclose(tiled.box, constant.box, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(four.initial_guess, np.tile(one.initial_guess, 4))
    np.testing.assert_array_equal(four.expand(np.array([0.1, 0.2])), np.tile(one.expand(np.array([0.1, 0.2])), 4))


def test_a_motion_under_knots_is_that_of_c_mujoco_under_their_table():
    task = tog.get_task("flip", knots=3)
    motion = tog.rollout(task, RAMP, "mjx")
    model, data = task.scene.model, mujoco.MjData(task.scene.model)
    for setpoints in plan(task):
        data.ctrl[task.scene.actuators] = setpoints
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(motion.box[-1, :3], data.qpos[task.scene.joints[:3]], atol=1e-9)


def test_gradients_of_both_modes_are_those_of_differences():
    cost = tog.objective(tog.get_task("flip", knots=3), "penalty")
    forward, reverse = jax.jacfwd(cost)(RAMP), jax.grad(cost)(RAMP)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    h = 1e-7 * np.eye(6)
    differences = [(cost(RAMP + row) - cost(RAMP - row)) / 2e-7 for row in h]
    np.testing.assert_allclose(reverse, differences, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tog.get_task("flip", knots=0), "knots is 0: give a whole number from 1 to 599"),
        (lambda: tog.get_task("flip", knots=600), "knots is 600"),
        (
            lambda: tog.get_task(tog.get_task("flip", knots=2), knots=3),
            r"Controls\(knots=2, .* already",
        ),
        (
            lambda: tog.rollout(tog.get_task("flip", knots=2), [0, 0]),
            r"\[2\]; flip takes \[4\]: finger1_x at knot 0",
        ),
    ],
)
def test_bad_knots_are_one_line(make, message):
    with pytest.raises(InputError, match=message):
        make()
