"""The recommended method: what it promises, and that it is what the studies compare."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.solving.solve import step_size
from tog_mjx.studies.cell import Cell, compute


@pytest.mark.parametrize(("name", "budget", "successes"), [("flip", 100, 100), ("grasp", 1000, 95)])
def test_a_guess_3_cm_off_succeeds_within_the_budget(name, budget, successes):
    updates = int(budget / 4)
    step = step_size(tog.get_task(name), updates)
    found = compute(Cell(name, "penalty", "solve", updates, tuple(range(100)), (0.03,), (step,)))
    assert len(found.costs) == 100
    assert (found.costs.min(axis=1) <= tog.get_task(name).success).sum() >= successes


@pytest.mark.parametrize(
    ("differentiation", "method", "updates"), [(None, "solve", 25), ("saltation", "saltation, solve", 20)]
)
def test_it_is_the_method_of_the_studies(differentiation, method, updates):
    descent = tog.solve("flip", budget=100, engine="penalty", differentiation=differentiation)
    found = compute(Cell("flip", "penalty", method, updates, steps=(step_size(tog.get_task("flip"), updates),)))
    np.testing.assert_allclose(descent.costs, found.costs[0], rtol=1e-9)
    np.testing.assert_allclose(descent.best, found.best[0], rtol=1e-9)
    assert descent.costs.min() < tog.get_task("flip").success


def test_the_gradient_is_the_one_asked_for():
    descents = [tog.solve("flip", budget=5, engine="penalty", differentiation=how) for how in ("native", "saltation")]
    for descent, how in zip(descents, ("native", "saltation"), strict=True):
        expected = jax.grad(tog.objective("flip", "penalty", differentiation=how))(descent.setpoints[0])
        np.testing.assert_allclose(descent.gradients, [expected], rtol=1e-9)
    assert descents[0].costs == descents[1].costs
    assert np.linalg.norm(descents[0].gradients - descents[1].gradients) > 0.1


def test_many_variables_and_another_guess():
    task = tog.get_task("flip", knots=4)
    descent = tog.solve(task, task.initial_guess + 0.01, budget=60, engine="penalty")
    np.testing.assert_array_equal(descent.setpoints[0], task.initial_guess + 0.01)
    assert descent.setpoints.shape == (15, 8)
    assert descent.costs.min() < descent.costs[0] / 10


def test_a_function_is_solved_as_the_task_is():
    task, J = tog.get_task("flip"), tog.objective("flip", "penalty")
    own = tog.solve(J, task.initial_guess, budget=100, reach=1.0)
    np.testing.assert_allclose(own.costs, tog.solve(task, budget=100, engine="penalty").costs, rtol=1e-12)
    np.testing.assert_array_equal(own.best, own.setpoints[own.best_iteration])


def test_a_function_of_a_pytree_comes_back_as_one():
    """Each variable may go as far as it is from zero: in the first update Adam moves all by their step."""
    target = {"gain": jnp.array([1500.0, 1400.0]), "offset": jnp.array(0.5)}

    def far(x):
        return ((x["gain"] - target["gain"]) ** 2).sum() / 1e6 + (x["offset"] - target["offset"]) ** 2

    found = tog.solve(far, {"gain": np.array([1000.0, 2000.0]), "offset": 0}, budget=400)
    assert found.costs.shape == (100,)
    assert (found.setpoints["gain"].shape, found.gradients["offset"].shape) == ((100, 2), (100,))
    np.testing.assert_allclose(np.diff(found.setpoints["gain"][:2], axis=0), [[20, -40]], rtol=1e-5)
    np.testing.assert_allclose(np.diff(found.setpoints["offset"][:2]), [0.02], rtol=1e-5)
    np.testing.assert_allclose(found.best["gain"], target["gain"], rtol=0.01)
    np.testing.assert_allclose(found.best["offset"], 0.5, atol=0.01)
    assert found.costs.min() == far(found.best)


def looped(x):
    return jax.lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, s[1] * 1.5), (0, x.sum()))[1]


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (
            ("flip",),
            {"budget": 3, "engine": "penalty"},
            "budget is 3: one gradient of flip on penalty takes 4.0 evaluations",
        ),
        (("flip",), {"engine": "bullet"}, "engine 'bullet' is unknown"),
        (("juggle",), {}, "problem 'juggle' is unknown"),
        (("flip",), {"engine": "released", "differentiation": "saltation"}, "'released' has no option 'different"),
        (("flip",), {"engine": "penalty", "differentiation": "implicit"}, "'implicit' is unknown; choose from nat"),
        (("flip", 100), {}, "the guess is 100: give a vector; a budget is given by its name, budget=100"),
        (("flip", np.ones((2, 1))), {"engine": "penalty"}, r"x has the shape \[2, 1\]; flip takes \[2\]: finger1_x"),
        ((jnp.sum,), {}, "a function has no guess of its own; give one"),
        ((jnp.sum, np.ones(2)), {"budget": 3}, "budget is 3: one gradient of sum takes 4.0 evaluations"),
        ((jnp.sum, np.ones(2)), {"reach": -1}, "reach is -1: give a positive number"),
        ((jnp.sum, np.ones(2)), {"engine": "mjx"}, "engine and differentiation are a problem's"),
        ((jnp.sum, {"a": "far"}), {}, r"the guess\['a'\] is of type str"),
        ((lambda x: x, np.ones(2)), {}, r"<lambda> returns an array of shape \[2\]; give one number"),
        ((lambda x: {"J": x}, np.ones(2)), {}, "<lambda> returns a dict; give one number"),
        ((lambda x: x["b"], {"a": 1.0}), {}, "<lambda> fails: KeyError: 'b'"),
        (
            (looped, np.ones(5)),
            {},
            "looped cannot be differentiated in reverse mode: there is a loop of unknown length",
        ),
    ],
)
def test_bad_input(arguments, options, message):
    with pytest.raises(tog.InputError, match=message):
        tog.solve(*arguments, **options)
