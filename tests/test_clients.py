"""Environments of others on `tog.step`: MuJoCo Playground and brax, as the README says."""

import importlib
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.checks.told.finding import Level
from tog_mjx.stepping._mjx import mjx

H = 1e-5


def imported(name: str):
    pytest.importorskip(name, reason=f"{name} is not installed: pip install '.[clients]'")
    return importlib.import_module(name)


def ball_in_cup():
    """Playground's, whose solver takes one iteration, and its start with the string taut."""
    registry = imported("mujoco_playground").registry
    environment = registry.load("BallInCup", config_overrides={"impl": "jax"})
    start = compile_quickly(environment.reset)(jax.random.key(1))
    taut = start.data.replace(qpos=jnp.array([0.0, 0.0, 0.02, -0.02]), qvel=jnp.array([0.3, 0.0, 0.1, -0.5]))
    return environment, start.replace(data=taut)


def inverted_pendulum():
    environment = imported("brax.envs").get_environment("inverted_pendulum", backend="mjx")
    return environment, compile_quickly(environment.reset)(jax.random.key(1))


@pytest.mark.parametrize("load", [ball_in_cup, inverted_pendulum])
def test_an_environments_step_has_the_derivative_of_its_value(load, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of theirs.
        environment, start = load()
        action = jnp.full(environment.action_size, 0.1)
        values = compile_quickly(jax.vmap(lambda t: environment.step(start, action + t).obs))
        behind, expected, ahead = values(jnp.array([-H, 0, H]))
        monkeypatch.setattr(mjx, "step", tog.step)
        slopes = compile_quickly(
            lambda t: jax.jvp(lambda t: environment.step(start, action + t).obs, (t,), (jnp.ones(()),))
        )
        found, slope = slopes(jnp.zeros(()))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-14)
    differences = (ahead - behind) / (2 * H)
    assert np.abs(differences).max() > 0.1
    np.testing.assert_allclose(slope, differences, rtol=0, atol=1e-8 * np.abs(differences).max())


def test_playgrounds_reward_has_no_derivative_within_an_infinite_bound():
    reward = imported("mujoco_playground._src.reward")

    def standing(height):
        return reward.tolerance(height[0], bounds=(1.2, float("inf")), margin=0.6)

    assert np.isnan(jax.grad(standing)(jnp.array([1.3]))).all()
    faults = [some for some in tog.check(standing, [1.3]).findings if some.level == Level.FAULT]
    assert [some.check for some in faults] == ["reverse mode"]
    assert "jnp.where" in faults[0].remedy
