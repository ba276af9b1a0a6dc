"""Scenes of one feature each: `tog.step` has the value of `mjx.step` and the derivative of its differences.

The derivative is of the next (qpos, qvel, act) with respect to (qpos, qvel, act, ctrl), at the state of each scene's
keyframe. Differences are of the stock step, so nothing of ours is in the reference. They are Richardson's, of a step h
and of 2 h, and h is
where a change of step changes them least: larger ones see curvature and kinks, smaller ones the solver's tolerance.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx._mjx import mjx

SCENES = sorted((Path(__file__).parent / "scenes").glob("*.xml"))
DIFFERENCE_STEPS = (3e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4)


class Feature(NamedTuple):
    """A scene at its state: x [n] = (qpos, qvel, act, ctrl), and the step as a function of x under either `step`."""

    x: jax.Array
    after: Callable[[Callable, jax.Array], jax.Array]


def load(path: Path) -> Feature:
    model = mujoco.MjModel.from_xml_path(str(path))
    key = model.key("state")
    state = {"qpos": key.qpos, "qvel": key.qvel, "act": key.act, "ctrl": key.ctrl}
    x, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(jnp.array, state))
    mjx_model = mjx.put_model(model)

    def after(step: Callable, x: jax.Array) -> jax.Array:
        data = step(mjx_model, mjx.make_data(mjx_model).replace(**unravel(x)))
        return jnp.concatenate([data.qpos, data.qvel, data.act])

    return Feature(x, after)


def differences(value: Callable[[jax.Array], jax.Array], x: jax.Array) -> np.ndarray:
    """The Jacobian [m, n] of `value`, which maps a batch [b, n] to [b, m]."""
    estimates = []
    for h in DIFFERENCE_STEPS:
        steps = h * np.concatenate([d * np.eye(x.size) for d in (1, -1, 2, -2)])
        plus, minus, plus2, minus2 = np.split(np.asarray(value(x + steps)), 4)
        estimates.append((8 * (plus - minus) - (plus2 - minus2)).T / (12 * h))
    changes = [np.abs(a - b).max() for a, b in itertools.pairwise(estimates)]
    return estimates[int(np.argmin(changes))]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_value_is_mjxs_and_the_derivative_is_that_of_differences(path):
    x, after = load(path)
    stock = jax.jit(jax.vmap(lambda x: after(mjx.step, x)))
    expected = differences(stock, x)
    scale = np.abs(expected).max()

    value, pull = jax.vjp(jax.jit(lambda x: after(tog.step, x)), x)
    np.testing.assert_allclose(value, stock(x[None])[0], rtol=0, atol=1e-12)
    reverse = np.stack([pull(row)[0] for row in jnp.eye(value.size)])
    np.testing.assert_allclose(reverse, expected, rtol=0, atol=1e-6 * scale)

    direction = jnp.array(np.random.default_rng(0).normal(size=x.size))
    forward = jax.jit(lambda x: jax.jvp(lambda x: after(tog.step, x), (x,), (direction,))[1])(x)
    np.testing.assert_allclose(forward, reverse @ direction, rtol=1e-9, atol=1e-9 * scale)
