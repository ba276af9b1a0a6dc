"""The recommended method: what it promises, and that it is what the studies compare."""

import jax
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.solve import step_size
from tog_mjx.studies.cell import SUCCESS, Cell, compute


@pytest.mark.parametrize(("name", "budget", "successes"), [("flip", 100, 100), ("grasp", 1000, 95)])
def test_a_guess_3_cm_off_succeeds_within_the_budget(name, budget, successes):
    updates = int(budget / 4)
    step = step_size(tog.get_task(name), updates)
    found = compute(Cell(name, "penalty", "solve", updates, tuple(range(100)), (0.03,), (step,)))
    assert len(found.costs) == 100
    assert (found.costs.min(axis=1) <= SUCCESS[name]).sum() >= successes


@pytest.mark.parametrize(
    ("differentiation", "method", "updates"), [(None, "solve", 25), ("saltation", "saltation, solve", 20)]
)
def test_it_is_the_method_of_the_studies(differentiation, method, updates):
    descent = tog.solve("flip", 100, "penalty", differentiation=differentiation)
    found = compute(Cell("flip", "penalty", method, updates, steps=(step_size(tog.get_task("flip"), updates),)))
    np.testing.assert_allclose(descent.costs, found.costs[0], rtol=1e-9)
    np.testing.assert_allclose(descent.setpoints_best, found.best[0], rtol=1e-9)
    assert descent.costs.min() < SUCCESS["flip"]


def test_the_gradient_is_the_one_asked_for():
    descents = [tog.solve("flip", 5, "penalty", differentiation=how) for how in ("native", "saltation")]
    for descent, how in zip(descents, ("native", "saltation"), strict=True):
        expected = jax.grad(tog.objective("flip", "penalty", differentiation=how))(descent.setpoints[0])
        np.testing.assert_allclose(descent.gradients, [expected], rtol=1e-9)
    assert descents[0].costs == descents[1].costs
    assert np.linalg.norm(descents[0].gradients - descents[1].gradients) > 0.1


def test_many_variables_and_another_guess():
    task = tog.get_task("flip", knots=4)
    descent = tog.solve(task, 60, "penalty", guess=task.initial_guess + 0.01)
    np.testing.assert_array_equal(descent.setpoints[0], task.initial_guess + 0.01)
    assert descent.setpoints.shape == (15, 8)
    assert descent.costs.min() < descent.costs[0] / 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("flip", 3, "penalty"), "budget is 3: one gradient of penalty takes 4.0 evaluations"),
        (("flip", 100, "bullet"), "simulator 'bullet' is unknown"),
        (("juggle",), "task 'juggle' is unknown"),
        (("flip", 100, "released", None, None, "saltation"), "'released' has no option 'differentiation'"),
        (("flip", 100, "penalty", None, None, "implicit"), "differentiation='implicit' is unknown; choose from native"),
    ],
)
def test_bad_input(arguments, message):
    with pytest.raises(tog.InputError, match=message):
        tog.solve(*arguments)
