"""The landscape is J over the window, and the released program's is the published picture."""

import jax
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.paper.tasks import get_task
from tog_mjx.studies.landscape import gradient_field, grid, landscape


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_costs_and_gradients_are_those_of_the_objective(name, tmp_path):
    task, cost = get_task(name), tog.objective(name, "penalty")
    found = landscape(task, "penalty", 9, tmp_path)
    ((x_min, x_max), (z_min, z_max)) = task.window
    for row, column in [(0, 0), (0, 8), (8, 0), (5, 6)]:
        point = np.array([x_min + (x_max - x_min) * column / 8, z_min + (z_max - z_min) * row / 8])
        np.testing.assert_allclose(found.points[9 * row + column], point)
        np.testing.assert_allclose(found.costs[row, column], cost(task.expand(point)), rtol=1e-9)
    field = gradient_field(task, "penalty", 3, tmp_path)
    middle = jax.grad(lambda point: cost(task.expand(point)))(field.points[4])
    np.testing.assert_allclose(field.points[4], np.mean(task.window, axis=1))
    np.testing.assert_allclose(field.gradients[4], middle, rtol=1e-9, atol=1e-12)


def test_the_grid_runs_along_x_first():
    points = grid(get_task("flip"), 5)
    np.testing.assert_allclose(points[:2], [[-0.5, 0], [-0.25, 0]])
    np.testing.assert_allclose(points[-1], [0.5, 1])


def test_the_released_flip_is_the_published_picture(tmp_path):
    """A flat region of 2.8 to 3.2 lower left, a dark basin upper right, the initial guess on the edge between."""
    task = get_task("flip")
    found = landscape(task, "released", 200, tmp_path)
    x, z = (found.points[:, i].reshape(200, 200) for i in (0, 1))
    flat = found.costs[(x < -0.1) & (z < 0.3)]
    assert flat.min() > 2.7
    assert flat.max() < 3.2
    assert np.mean((flat > 2.8) & (flat < 3.2)) > 0.95
    basin = found.costs[(x > 0.1) & (z > 0.7)]
    assert basin.max() < 0.2
    near = (np.abs(x - task.initial_guess[0]) < 0.1) & (np.abs(z - task.initial_guess[1]) < 0.1)
    assert found.costs[near].max() > 2.7
    assert found.costs[near].min() < 1.6
