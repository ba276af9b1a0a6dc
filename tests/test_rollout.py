"""The road from setpoints to a trajectory and a cost."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog


@pytest.mark.parametrize("simulator", ["penalty", "released", "mjx"])
def test_a_rollout_starts_at_the_start_and_ends_with_the_cost(simulator):
    task = tog.get_task("flip")
    motion = tog.rollout("flip", task.initial_guess, simulator)
    assert (motion.time.shape, motion.box.shape, motion.fingers.shape) == ((600,), (600, 6), (600, 1, 4))
    np.testing.assert_allclose(np.asarray(motion.time)[[0, -1]], [0, 0.599])
    np.testing.assert_array_equal(motion.box[0], task.scene.start[0])
    cost = tog.objective("flip", simulator)(task.initial_guess)
    np.testing.assert_allclose(cost, motion.box[-1, 0] ** 2 + motion.box[-1, 2] ** 2, rtol=1e-12)


def test_the_grasps_cost_is_the_papers():
    motion = tog.rollout("grasp", [-0.1, 0.4, 0.1, 0.5], "penalty")
    x, z, theta, vx, vz, omega = np.asarray(motion.box[-1])
    expected = (z - 1) ** 2 + 0.1 * (x**2 + theta**2 + vx**2 + vz**2 + omega**2)
    np.testing.assert_allclose(tog.objective("grasp", "penalty")([-0.1, 0.4, 0.1, 0.5]), expected, rtol=1e-12)


def test_the_objective_composes_with_jit_vmap_and_grad():
    objective = tog.objective("flip", "penalty")
    us = jnp.array([[0.0, 0.25], [0.2, 0.6]])
    one_by_one = [jax.grad(objective)(u) for u in us]
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(objective)))(us), one_by_one, rtol=1e-9)
    np.testing.assert_allclose(jax.jacfwd(objective)(us[0]), one_by_one[0], rtol=1e-9)


@pytest.mark.parametrize("kind", [list, np.array, jnp.array])
def test_setpoints_that_a_transformation_does_not_trace_are_known(kind):
    """A compiled function of something else, with J at fixed setpoints in it."""
    J = tog.objective("flip", "penalty")
    u, bad = kind([0.0, 0.25]), kind([0.0, np.nan])
    value, slope = jax.jit(jax.value_and_grad(lambda a: a * J(u)))(2.0)
    np.testing.assert_allclose([value, slope], [2 * J(u), J(u)], rtol=1e-12)
    np.testing.assert_allclose(
        jax.grad(lambda z: J([0.0, z]))(0.25), jax.grad(J)(jnp.array([0.0, 0.25]))[1], rtol=1e-12
    )
    with pytest.raises(tog.InputError, match="not finite"):
        jax.jit(lambda a: a * J(bad))(1.0)


def test_inside_jit_first_and_then_alone():
    inside = jax.jit(lambda u: tog.rollout("grasp", u, "released").box[-1])(jnp.array([-0.1, 0.4, 0.1, 0.5]))
    np.testing.assert_allclose(tog.rollout("grasp", [-0.1, 0.4, 0.1, 0.5], "released").box[-1], inside, rtol=1e-9)


def test_an_equal_objective_does_not_compile_again():
    """A compiled function runs its Python once, as it is traced."""
    traced: list[jax.Array] = []

    def cost(last):
        traced.append(last.qpos)
        return jnp.sum(last.qpos**2)

    task = dataclasses.replace(tog.get_task("grasp"), cost=cost)
    values = [tog.objective(task, "penalty", friction="paper")([x, 0.4, 0.1, 0.5]) for x in (-0.1, 0.0)]
    assert values[0] != values[1]
    assert len(traced) == 1
    jax.eval_shape(tog.objective(task, "penalty", friction="mujoco"), [-0.1, 0.4, 0.1, 0.5])
    assert len(traced) == 2


def test_precision_follows_the_flag():
    objective = tog.objective("flip", "penalty")
    with jax.enable_x64(False):
        assert objective([0.0, 0.25]).dtype == jnp.float32
    assert objective([0.0, 0.25]).dtype == jnp.float64
    with jax.enable_x64(False):
        assert tog.rollout("flip", [0.0, 0.25], "penalty").box.dtype == jnp.float32
    assert tog.rollout("flip", [0.0, 0.25], "penalty").box.dtype == jnp.float64


def test_mirrored_setpoints_give_mirrored_motions():
    # The grasp's scene is its own mirror image: exchange the fingers and the sign of x and theta.
    u = np.array([-0.1, 0.4, 0.15, 0.5])
    mirror = np.array([-u[2], u[3], -u[0], u[1]])
    one, other = (tog.rollout("grasp", v, "penalty") for v in (u, mirror))
    np.testing.assert_allclose(one.box, other.box * np.array([-1, 1, -1, -1, 1, -1]), atol=1e-9)
    np.testing.assert_allclose(one.fingers, other.fingers[:, ::-1] * np.array([-1, 1, -1, 1]), atol=1e-9)


@pytest.mark.parametrize(
    ("u", "message"),
    [
        ([0.0], r"shape \[1\]; flip takes \[2\]"),
        ([[0.0, 0.25]], r"shape \[1, 2\]"),
        ([0.0, float("nan")], "not finite"),
        ([0.0, float("inf")], "not finite"),
        (["here", "there"], "not numbers"),
    ],
)
@pytest.mark.parametrize(
    "road", [lambda u: tog.rollout("flip", u, "penalty"), lambda u: tog.objective("flip", "penalty")(u)]
)
def test_bad_setpoints_are_one_line(road, u, message):
    with pytest.raises(tog.InputError, match=message) as caught:
        road(u)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("task", "simulator", "options", "message"),
    [
        ("fly", "mjx", {}, "problem 'fly' is unknown; choose from flip, grasp"),
        ("flip", "bullet", {}, "engine 'bullet' is unknown; choose from mjx, penalty, released"),
        ("flip", "mjx", {"friction": "paper"}, "no option 'friction'; it takes differentiation"),
        ("flip", "penalty", {"friction": "none"}, "friction='none' is unknown; choose from mujoco, paper"),
    ],
)
def test_unknown_names_are_one_line(task, simulator, options, message):
    with pytest.raises(tog.InputError, match=message):
        tog.objective(task, simulator, **options)
