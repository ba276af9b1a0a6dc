"""Policies on the paper's tasks: what is kept of the study, and that its code still learns."""

import runpy
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import tog_mjx as tog

FOLDER = Path(__file__).parent.parent / "scripts" / "findings"
TABLE = pd.read_csv(FOLDER / "closed_loop.csv")


@pytest.fixture(scope="module")
def study() -> dict:
    return runpy.run_path(str(FOLDER / "closed_loop.py"))


def test_both_methods_succeed_on_both_tasks(study):
    assert set(TABLE.task) == set(study["SUCCESS"])
    assert set(TABLE.method) == set(study["METHODS"])
    assert TABLE.groupby(["task", "method"]).success.mean().min() > 0.95


def test_the_policys_gradient_on_mjx_is_right_and_trains():
    kept = pd.read_csv(FOLDER / "closed_loop_mjx.csv").iloc[0]
    assert kept["error against differences"] < 1e-6
    assert kept["forward against reverse"] < 1e-12
    assert kept["J after"] < 0.1 * kept["J before"]
    assert kept["MB, 50 steps a checkpoint"] < kept["MB of reverse mode, 1000 steps"] / 2


def test_a_training_through_mjx_succeeds_on_both_tasks():
    kept = pd.read_csv(FOLDER / "closed_loop_gpu.csv")
    assert set(kept.task) == set(TABLE.task)
    assert kept.success.min() > 0.95


def test_starts_do_not_overlap_and_differ(study):
    """A finger stays on its side of the box, and nothing is lower than in the scene."""
    problem = study["closed_loop"]("grasp", starts=64)
    here, drawn = problem.origin.qpos, jax.vmap(problem.start.sample)(jax.random.split(jax.random.key(0), 64))["qpos"]
    moved = np.asarray(drawn) - here
    heights = moved[:, [1, 4, 6]]
    assert (heights >= 0).all()
    np.testing.assert_array_equal(moved[:, 2], 0)
    gaps = (moved[:, [3, 5]] - moved[:, :1]) * np.sign(here[[3, 5]] - here[0])
    assert (gaps >= -1e-12).all()
    np.testing.assert_allclose([moved[:, 0].std(), heights.std() / np.sqrt(1 - 2 / np.pi)], study["SPREAD"], rtol=0.25)


def test_a_short_training_flips_boxes_that_it_has_not_seen(study):
    """48 updates of 16 starts; the gradient of the policy is that of differences before and after."""
    with jax.enable_x64():
        problem = study["closed_loop"]("flip", starts=16)
        before = study["judge"](problem, problem.x0)
        found = tog.solve(problem, budget=48 * 16 * 4, reach=0.1, engine="penalty")
        after = study["judge"](problem, found.last)
        assert before["success"] == 0
        assert after["median"] < 0.1 * before["median"]
        J, key = tog.objective(problem, "penalty"), jax.random.key(1)
        direction = jnp.asarray(np.random.default_rng(0).normal(size=problem.x0.shape))
        along = jax.jit(lambda t: J(problem.x0 + t * direction, key))
        h = 1e-7
        np.testing.assert_allclose(jax.grad(along)(0.0), (along(h) - along(-h)) / (2 * h), rtol=1e-5)
