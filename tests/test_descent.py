"""Descents with a known course."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tog_mjx.gradients import exact, stochastic
from tog_mjx.paper.comparison import Run, compute
from tog_mjx.solving.descent import Status, descend

CURVATURE = jnp.array([1.0, 4.0])


def bowl(u):
    return 0.5 * jnp.sum(CURVATURE * u**2)


def test_a_quadratic_shrinks_by_its_factors():
    start, alpha = np.array([1.0, -2.0]), 0.1
    descent = descend(exact(bowl), start, step_size=alpha, iterations=20)
    factors = (1 - alpha * np.asarray(CURVATURE)) ** np.arange(21)[:, None]
    np.testing.assert_allclose(descent.setpoints, factors * start, rtol=1e-12)
    np.testing.assert_allclose(descent.costs, [bowl(u) for u in descent.setpoints], rtol=1e-12)
    np.testing.assert_allclose(descent.gradients, CURVATURE * descent.setpoints, rtol=1e-12)
    assert (descent.status, descent.iterations, descent.best_iteration) == (Status.EXHAUSTED, 20, 20)


def test_it_is_told_in_one_line():
    """Also that it never moved, as where an arm does not reach the ball."""
    descent = descend(exact(bowl), [1.0, 0.0], step_size=0.5, iterations=2)
    assert repr(descent) == ("Descent: J from 0.5 to 0.03125, at iterate 2 of 2 (iterations exhausted); `best` has it")
    flat = descend(exact(lambda u: 2.0 + 0 * u.sum()), [1.0, 0.0], step_size=0.5, iterations=2)
    assert repr(flat).endswith(
        "at iterate 0 of 2 (iterations exhausted; every gradient was zero: begin elsewhere); `best` has it"
    )
    many = descent._replace(held_out=np.array([np.nan, 0.25, 0.5]))
    assert "J from 0.5 to 0.125, on held-out starts 0.25, at iterate 1 of 2" in repr(many)


def test_it_converges():
    descent = descend(exact(bowl), [1.0, 1.0], step_size=0.2, iterations=10_000, tolerance=1e-6)
    assert descent.status is Status.CONVERGED
    # The last update of the slow direction was alpha u = 0.2 * 0.8^k <= 1e-6.
    assert descent.iterations == int(np.ceil(np.log(1e-6 / 0.2) / np.log(0.8)))


def test_best_and_last_differ_when_it_diverges():
    descent = descend(exact(bowl), [0.0, 1.0], step_size=0.6, iterations=5)
    assert descent.best_iteration == 0
    assert descent.costs[-1] > descent.costs[0]
    np.testing.assert_array_equal(descent.best, [0, 1])
    np.testing.assert_allclose(descent.last, [0, (1 - 0.6 * 4) ** 5])


def test_a_nan_gradient_ends_it_and_the_last_good_iterate_is_kept():
    def cliff(u):
        # Finite everywhere, but the root's derivative at and below zero is not.
        return jnp.sum(jnp.where(u > 0, jnp.sqrt(u), 0.0)) + jnp.sum(u)

    descent = descend(exact(cliff, "reverse"), [1.0], step_size=0.4, iterations=50)
    assert descent.status is Status.NON_FINITE
    assert np.isfinite(descent.costs).all()
    assert np.isfinite(descent.gradients[:-1]).all()
    assert not np.isfinite(descent.gradients[-1]).all()
    assert descent.iterations == 2  # 1, 0.4, and then below zero.


def test_an_infinite_cost_ends_it_before_that_iterate():
    wall = descend(exact(lambda u: jnp.where(u[0] < -1, jnp.inf, u[0])), [0.0], step_size=0.4, iterations=10)
    assert wall.status is Status.NON_FINITE
    np.testing.assert_allclose(wall.setpoints[:, 0], [0, -0.4, -0.8])


def test_the_key_decides_the_stochastic_course():
    estimate = stochastic(bowl, 0.1)
    first, again, other = (
        descend(estimate, [1.0, 1.0], step_size=0.5, iterations=30, key=jax.random.key(k)).setpoints for k in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_each_iteration_splits_the_key_once():
    sigma, alpha, u, key = 0.1, 0.5, np.array([1.0, 1.0]), jax.random.key(5)
    descent = descend(stochastic(bowl, sigma), u, step_size=alpha, iterations=4, key=key)
    for iterate in descent.setpoints:
        np.testing.assert_allclose(iterate, u, rtol=1e-12)
        key, subkey = jax.random.split(key)
        w = sigma * jax.random.normal(subkey, (2,))
        u = u - alpha * (bowl(u + w) - bowl(u)) * w


def test_it_reports_how_far_it_is():
    seen: list[int] = []
    descend(exact(bowl), [1.0, 1.0], step_size=0.1, iterations=40, report=seen.append)
    assert seen == sorted(set(seen))
    assert (seen[0], seen[-1]) == (1, 41)


def test_no_iterations_evaluate_the_guess():
    descent = descend(exact(bowl), [1.0, 0.0], step_size=0.1, iterations=0)
    np.testing.assert_array_equal(descent.costs, [0.5])


@pytest.mark.parametrize(
    ("start", "settings", "message"),
    [
        ([1.0], {"iterations": -1}, "iterations is -1"),
        ([1.0], {"iterations": 10**12}, "whole number from 0 to"),
        ([1.0], {"tolerance": float("nan")}, "tolerance is nan"),
        (1.0, {}, r"shape \(\); give a vector"),
        ([[1.0]], {}, r"shape \(1, 1\)"),
        (["a"], {}, "not numbers"),
        ([1.0], {"step_size": 0.0}, "step_size is 0"),
        ([1.0], {"step_size": float("nan")}, "step_size is nan"),
        ([float("nan")], {}, "initial guess is nan"),
    ],
)
def test_bad_settings_are_refused(start, settings, message):
    with pytest.raises(ValueError, match=message):
        descend(exact(lambda u: jnp.sum(u**2)), start, **({"step_size": 0.1, "iterations": 3} | settings))


def test_exact_descent_on_mjx_flips_the_box():
    descent = compute(Run("mjx", "flip", "exact", iterations=10))
    assert descent.costs.min() <= 0.2
    assert descent.costs[-1] <= 0.2


def test_exact_descent_on_mjx_grasps_the_box_and_then_loses_it():
    descent = compute(Run("mjx", "grasp", "exact", iterations=150))
    assert descent.costs.min() <= 0.2
    # The last iterate is another story: a steep gradient throws the fingers away from the box.
    assert descent.costs[-1] > 0.5
