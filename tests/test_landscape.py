"""The landscape is J over a plane of a problem's variables, and the released program's is the published picture."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.paper.tasks import get_task
from tog_mjx.problems import Plane
from tog_mjx.studies.landscape import gradient_field, landscape

BALL = """<mujoco model="ball"><option timestep="0.01" gravity="0 0 0" iterations="10"/>
  <worldbody><body>
    <joint name="x" type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><geom size="0.1" mass="2"/>
  </body></worldbody>
  <actuator><motor name="push" joint="x" ctrlrange="-1 3"/></actuator></mujoco>"""
STEPS, H, MASS = 20, 0.01, 2


def cost(x, y, vx):
    return (x - 0.1) ** 2 + 3 * y**2 + 0.5 * vx * y


def ball(**changes) -> tog.Problem:
    """A ball in space. Its variables: both velocities of the start, and a constant push along x."""
    settings = {"variables": [tog.Start("qvel"), tog.Controls()], "guess": [0.5, 0.25, 1.0], **changes}
    return tog.Problem(
        mujoco.MjSpec.from_string(BALL),
        STEPS,
        **{"cost": lambda last: cost(last.qpos[0], last.qpos[1], last.qvel[0]), **settings},
    )


def exact(x: np.ndarray):
    """J [...] of variables [..., 3]: semi-implicit Euler, summed."""
    vx, vy, push = np.moveaxis(np.asarray(x), -1, 0)
    a, T = push / MASS, STEPS * H
    return cost(T * vx + H**2 * a * STEPS * (STEPS + 1) / 2, T * vy, vx + a * T)


def test_costs_over_two_variables_are_those_of_the_closed_form_and_kept_for_an_equal_problem(tmp_path):
    """The window is the actuator's range, and where there are no bounds the guess +- a large change."""
    for weight, is_new in [(1.0, True), (2.0, True), (2.0, False)]:
        problem = ball(cost=lambda last, weight=weight: weight * cost(last.qpos[0], last.qpos[1], last.qvel[0]))
        plane = Plane.of(problem, "push", "qvel[1]")
        np.testing.assert_array_equal([plane.low, plane.high], [[-1, -0.75], [3, 1.25]])
        said: list[int] = []
        found = landscape(problem, "mjx", plane, 5, tmp_path, said.append)
        assert said == ([25] if is_new else [])
        np.testing.assert_allclose(found.points[[8, 20]], [[2, -0.25], [-1, 1.25]])
        expected = exact(np.array([[0.5, -0.25, 2], [0.5, 1.25, -1]]))
        np.testing.assert_allclose([found.costs[1, 3], found.costs[4, 0]], weight * expected, rtol=1e-12)


def test_a_plane_may_lie_across_all_variables():
    axes = np.array([[1.0, 2, 0], [0, 1, -1]])
    plane = Plane(np.array([0.1, 0.2, 0.3]), axes, np.array([-1.0, 0]), np.array([1.0, 1]), ("along", "across"))
    x = np.array([0.1, 0.2, 0.3]) + 0.5 * axes[0] - 2 * axes[1]
    np.testing.assert_allclose(plane.x(np.array([0.5, -2])), x)
    np.testing.assert_allclose(plane.project(x + np.cross(*axes)), [0.5, -2])
    found = gradient_field(ball(), "mjx", plane, 3)
    np.testing.assert_allclose(found.points[[0, 4]], [[-2 / 3, 1 / 6], [0, 0.5]])
    h, at = 1e-6, plane.x(found.points)
    slopes = [(exact(at + h * axis) - exact(at - h * axis)) / (2 * h) for axis in axes]
    np.testing.assert_allclose(found.gradients, np.transpose(slopes), rtol=1e-8)


def test_of_many_starts_it_is_the_mean_over_those_of_one_key():
    starts = tog.Starts(lambda key: {"qpos": 0.1 * jax.random.normal(key, (2,))}, 5)
    problem = ball(start=starts)
    plane = Plane.of(problem)
    np.testing.assert_array_equal(plane.x(plane.high), [1.5, 1.25, 1])
    drawn = jax.vmap(starts.sample)(jax.random.split(jax.random.key(0), 5))["qpos"]
    x, y = 0.2 * 1.5 + H**2 * 0.5 * 210, 0.2 * 1.25
    expected = np.mean([cost(x + dx, y + dy, 1.6) for dx, dy in np.asarray(drawn)])
    np.testing.assert_allclose(landscape(problem, "mjx", plane, 2).costs[1, 1], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"first": "pusch"}, "pusch"),
        ({"first": 3}, "there is no variable 3; the problem has 3, from 0 on"),
        ({"first": "push", "second": 2}, "both variables are push"),
        ({"window": [[0, 1], [2, 2]]}, r"the window \[\[0.0, 1.0\], \[2.0, 2.0\]\] is none"),
        ({"window": [0, 1]}, r"the window \[0.0, 1.0\] is none"),
        ({"through": [1.0]}, "x has the shape"),
    ],
)
def test_bad_planes_are_one_line(choice, message):
    with pytest.raises(tog.InputError, match=message):
        Plane.of(ball(), **choice)


@pytest.mark.parametrize("over", [landscape, gradient_field])
@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"problem": "fly"}, "problem 'fly' is unknown"),
        ({"engine": "bullet"}, "engine 'bullet' is unknown"),
        ({"differentiation": "none"}, "differentiation='none' is unknown"),
        ({"size": 0}, "size is 0: give a whole number from 1"),
    ],
)
def test_bad_names_and_sizes_are_one_line(over, choice, message):
    with pytest.raises(tog.InputError, match=message):
        over(**{"problem": "flip", "size": 2, **choice})


def test_one_variable_makes_no_plane():
    with pytest.raises(tog.InputError, match="there is no variable 1; the problem has 1"):
        tog.landscape(ball(variables=tog.Controls(), guess=None))


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_costs_and_gradients_of_a_task_are_those_of_its_window(name, tmp_path):
    task, J = get_task(name), tog.objective(name, "penalty")
    found = landscape(task, "penalty", task.plane, 9, tmp_path)
    ((x_min, x_max), (z_min, z_max)) = task.window
    for row, column in [(0, 0), (0, 8), (8, 0), (5, 6)]:
        point = np.array([x_min + (x_max - x_min) * column / 8, z_min + (z_max - z_min) * row / 8])
        np.testing.assert_allclose(found.points[9 * row + column], point)
        np.testing.assert_allclose(found.costs[row, column], J(task.expand(point)), rtol=1e-9)
    field = gradient_field(task, "penalty", task.plane, 3, tmp_path)
    middle = jax.grad(lambda point: J(task.expand(point)))(field.points[4])
    np.testing.assert_allclose(field.points[4], np.mean(task.window, axis=1))
    np.testing.assert_allclose(field.gradients[4], middle, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["flip", "grasp"])
@pytest.mark.parametrize("knots", [1, 3])
def test_the_plane_of_a_task_is_its_window_to_the_last_bit(name, knots):
    task = get_task(name, knots=knots)
    points = task.plane.grid(7)
    np.testing.assert_array_equal(task.plane.x(points), jax.vmap(task.expand)(jnp.asarray(points)))
    np.testing.assert_allclose(task.plane.project(task.plane.x(points)), points, atol=1e-14)


def test_the_grid_runs_along_the_first_axis_first():
    points = get_task("flip").plane.grid(5)
    np.testing.assert_allclose(points[:2], [[-0.5, 0], [-0.25, 0]])
    np.testing.assert_allclose(points[-1], [0.5, 1])


def test_the_released_flip_is_the_published_picture(tmp_path):
    """A flat region of 2.8 to 3.2 lower left, a dark basin upper right, the initial guess on the edge between."""
    task = get_task("flip")
    found = landscape(task, "released", task.plane, 200, tmp_path)
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
