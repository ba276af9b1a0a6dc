"""The rivals of the benchmark compute the same as this package, or a comparison of times would mean nothing."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.engines import make_simulator, reference
from tog_mjx.paper.tasks import get_task
from tog_mjx.studies.benchmarks.rivals import c_loop, python_loop
from tog_mjx.studies.benchmarks.timing import compiled, interleaved

FLIP = get_task("flip")


def test_the_c_loop_is_the_penalty_simulator():
    points = np.random.default_rng(0).uniform((-0.5, 0), (0.5, 1), (100, 2)).astype(np.float32)
    with c_loop(FLIP) as flips:
        if flips is None:
            pytest.skip("no C compiler")
        found = flips(points)
    assert np.array(5e-324) * np.array(1.0) > 0  # Its fast arithmetic is its own.
    expected = jax.vmap(tog.objective("flip", "penalty"))(points)
    # Single precision against double, over 599 steps.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3)
    assert np.median(np.abs(found - expected)) < 1e-5


def test_the_python_loop_is_the_scan_cut_short():
    u = jnp.array([0.2, 0.6])
    cost = python_loop(FLIP, make_simulator("penalty", FLIP.scene), 5)
    box = tog.rollout("flip", u, "penalty").box[5]
    np.testing.assert_allclose(jax.jit(cost)(u), box[0] ** 2 + box[2] ** 2, rtol=1e-12)


def test_c_mujoco_under_knots_is_mjx():
    task = get_task("flip", knots=3)
    rows = np.array([[0.0, 0.25, 0.2, 0.4, 0.1, 0.8], [0.1, 0.3, 0.2, 0.6, 0.2, 0.9]])
    found = reference.final_costs(task, rows)
    np.testing.assert_allclose(found, jax.vmap(tog.objective(task, "penalty"))(rows), atol=1e-2)
    constant = np.tile(FLIP.initial_guess, 3)[None]
    np.testing.assert_allclose(
        reference.final_costs(task, constant), reference.final_costs(FLIP, constant[:, :2], threads=1), atol=1e-9
    )


def test_a_program_says_what_it_took():
    """A product of two matrices is kept while the next is made of it: 0.72 MB of doubles."""
    x = np.random.default_rng(0).normal(size=(300, 300))
    program = compiled(lambda x: x @ x @ x, jnp.array(x))
    np.testing.assert_allclose(program.run(), x @ x @ x, atol=1e-9)
    assert program.seconds_compile > 0
    assert 0.72 <= program.megabytes < 1.5


def test_each_gets_its_own_median_in_turns():
    order: list[str] = []
    found = interleaved({name: functools.partial(order.append, name) for name in "ab"}, 3)
    assert order == ["a", "b"] * 4
    assert set(found) == {"a", "b"}
