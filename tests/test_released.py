"""The released program reproduces the published numbers, and its mathematics everywhere else."""

import jax.numpy as jnp
import numpy as np
import pytest
import released_oracle
from states import state_of_box

from tog_mjx.engines import make_simulator
from tog_mjx.paper.comparison import Run, compute
from tog_mjx.paper.published import published
from tog_mjx.paper.tasks import get_task


def test_exact_flip_is_the_published_one():
    descent = compute(Run("released", "flip", "exact"))
    np.testing.assert_allclose(descent.costs, published("flip", "exact").costs, atol=5e-5)
    assert descent.costs.dtype == np.float32
    np.testing.assert_allclose(descent.setpoints, published("flip", "exact").setpoints, atol=5e-4)


def test_exact_grasp_is_the_published_one_and_stays_mirror_symmetric():
    descent = compute(Run("released", "grasp", "exact"))
    np.testing.assert_allclose(descent.costs, published("grasp", "exact").costs, atol=5e-4)
    known = published("grasp", "exact")
    assert known.setpoints_at.tolist() == [0, 1, 2, 50, 100]
    np.testing.assert_allclose(descent.setpoints[known.setpoints_at], known.setpoints, atol=5e-4)
    np.testing.assert_array_equal(descent.setpoints[:, :2], descent.setpoints[:, 2:] * [-1, 1])


def test_stochastic_flip_is_the_published_one():
    descent = compute(Run("released", "flip", "stochastic"))
    np.testing.assert_allclose(descent.costs, published("flip", "stochastic").costs, atol=1e-4)


def test_stochastic_grasp_never_lifts():
    descent = compute(Run("released", "grasp", "stochastic"))
    known = published("grasp", "stochastic")
    assert descent.iterations == known.iterations == 1000
    assert descent.costs.min() > 0.56
    found = descent.costs[0], descent.costs[-1], descent.costs.min()
    np.testing.assert_allclose(found, (known.cost_first, known.cost_last, known.cost_best), atol=1e-5)


def test_it_is_the_released_mathematics_at_any_setpoint(compiled):
    task, points = compiled.task, compiled.setpoints[:6]
    simulator = make_simulator("released", task.scene)
    found = compiled.motions(simulator, compiled.setpoints)
    costs = [task.cost(state_of_box(task, box)) for box in found.box[:6, -1]]
    expected = [released_oracle.cost(task.name, np.asarray(u)) for u in points]
    np.testing.assert_allclose(costs, expected, rtol=1e-9)

    gradients = compiled.gradients(simulator, compiled.setpoints)[:6]
    h = 1e-7
    for u, gradient in zip(np.asarray(points), gradients, strict=True):
        steps = h * np.eye(u.size)
        plus, minus = ([released_oracle.cost(task.name, u + s * d) for d in steps] for s in (1, -1))
        difference = (np.array(plus) - np.array(minus)) / (2 * h)
        np.testing.assert_allclose(gradient, difference, atol=1e-4 * np.abs(difference).max() + 1e-6)


def test_fingers_are_points_at_the_surface_of_the_scenes_spheres():
    task = get_task("grasp")
    state = make_simulator("released", task.scene).init(*task.scene.start)
    np.testing.assert_allclose(state.fingers[:, 0], [-0.3, 0.3], atol=1e-15)
    assert state.fingers.dtype == jnp.float64


@pytest.mark.parametrize("option", ["friction", "differentiation"])
def test_it_takes_no_options(option):
    with pytest.raises(ValueError, match="no option"):
        make_simulator("released", get_task("flip").scene, **{option: "paper"})
