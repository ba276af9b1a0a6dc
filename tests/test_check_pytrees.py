"""`tog.check` at any pytree: its leaves are named, and its derivative is that of each number."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.told.finding import Level


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64():
        yield


class Params(NamedTuple):
    gain: float
    table: np.ndarray


def test_a_pytree_is_checked_number_by_number():
    def of_params(params):
        return params.gain * params.table[1, 0] ** 2 + jnp.sin(params.table).sum()

    table = np.array([[0.1, 0.2], [5.0, 0.4]], np.float32)
    verdict = tog.check(of_params, Params(2, table))
    assert verdict.level == Level.FINE
    assert verdict.variables == ("x.gain", "x.table[0, 0]", "x.table[0, 1]", "x.table[1, 0]", "x.table[1, 1]")
    expected = np.cos(np.asarray(table, float)) + np.array([[0, 0], [20.0, 0]])
    np.testing.assert_allclose(verdict.gradient, [[25.0, *expected.ravel()]], rtol=1e-12)
    (precision,) = [some for some in verdict.findings if some.check == "precision"]
    assert precision.value  # Float32 has been compared.
    assert precision.value < 1e-5


def test_the_leaf_that_is_dropped_is_named():
    x = {"w": np.full((2, 2), 0.5), "b": (np.array(0.3),)}
    small = tog.check(lambda p: (jax.lax.stop_gradient(p["w"]) ** 2).sum() + p["b"][0], x)
    assert small.reason is not None
    assert small.reason.sentence.startswith("x['w'][0, 0], x['w'][0, 1], x['w'][1, 0], ...: autodiff says zero, but")

    def network(params):
        (first, second) = params["layers"]
        hidden = jnp.tanh(first["kernel"].T @ jnp.linspace(-1, 1, 5) + jax.lax.stop_gradient(first["bias"]))
        return second["kernel"].T @ hidden

    random = np.random.default_rng(0)
    first = {"kernel": random.normal(size=(5, 8)), "bias": random.normal(size=8)}
    large = tog.check(network, {"layers": [first, {"kernel": random.normal(size=(8, 2))}]})
    assert large.reason is not None
    assert large.reason.sentence.startswith("x['layers'][0]['bias'] along a random direction: autodiff says zero, but")
    assert large.subject == "network in 64 variables"


def test_arrays_of_any_shape_and_numbers_alone_are_points():
    assert tog.check(lambda x: x**2, 3.0).gradient == [[6.0]]
    verdict = tog.check(jnp.linalg.det, np.array([[1.0, 2.0], [3.0, 5.0]]))
    assert verdict.variables == ("x[0, 0]", "x[0, 1]", "x[1, 0]", "x[1, 1]")
    np.testing.assert_allclose(verdict.gradient, [[5.0, -3.0, -2.0, 1.0]], rtol=1e-9)
    assert tog.check(lambda x: x @ x, [0.5, 1.0]).variables == ("x[0]", "x[1]")
    assert tog.check(lambda x: x[0] @ x[1], (np.ones(2), np.ones(2))).variables[-1] == "x[1][1]"
