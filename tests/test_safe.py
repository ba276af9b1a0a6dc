"""The singular points of `tog_mjx.stepping.safe`."""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from tog_mjx.stepping.safe import cos_sinc, quotient, safe_norm


def test_norm_and_its_gradient_are_zero_at_zero():
    value, gradient = jax.value_and_grad(safe_norm)(jnp.zeros(3))
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros(3))
    np.testing.assert_array_equal(jax.jacfwd(safe_norm)(jnp.zeros(3)), np.zeros(3))


def test_norm_elsewhere():
    x = jnp.array([[3.0, 4.0], [-1e-8, 0.0]])
    np.testing.assert_allclose(safe_norm(x), [5, 1e-8])
    check_grads(lambda x: safe_norm(jnp.asarray(x)), (x[0],), order=2, modes=["fwd", "rev"])


def test_a_quotient_of_tiny_numbers_has_its_derivative():
    at = jnp.float32(3e-25), jnp.float32(2e-25)
    assert quotient(*at) == at[0] / at[1]
    assert not np.isfinite(jax.grad(lambda x, y: x / y, 1)(*at))
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(quotient, (0, 1))(*at), (0.5e25, -0.75e25), rtol=1e-6)


def derivative(squared: float, odd: int, order: int) -> float:
    """Of cos(a), or of sin(a) / a if `odd`, in s = a^2: the series of (-s)^k / (2 k + odd)!, in exact fractions."""
    s, powers = Fraction(squared), range(order, 40)
    return float(sum((-1) ** k * math.perm(k, order) * s ** (k - order) / math.factorial(2 * k + odd) for k in powers))


SQUARED = [0.0, 1e-300, 1e-9, *(1e-6 * f for f in (1 - 1e-9, 1.0, 1 + 1e-9, 1.1)), 1e-4, 0.1,
           np.nextafter(1.0, 0), 1.0, np.nextafter(1.0, 2), 1.1, 3.0, 9.0, 9.8, 20.0]  # fmt: skip
"""Angles of 0 to 4.5, close about one thousandth and one."""


@pytest.mark.parametrize("order", [0, 1, 2])
def test_cos_and_sinc_and_their_derivatives_at_every_angle(order):
    def found(dtype):
        functions = [lambda s, i=i: cos_sinc(s)[i] for i in (0, 1)]
        for _ in range(order):
            functions = [jax.grad(function) for function in functions]
        return np.array([jax.vmap(function)(jnp.array(SQUARED, dtype)) for function in functions])

    expected = [[derivative(squared, odd, order) for squared in SQUARED] for odd in (0, 1)]
    np.testing.assert_allclose(found(jnp.float64), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found(jnp.float32), expected, rtol=0, atol=1e-6)
