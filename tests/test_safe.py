"""The singular points of `tog_mjx.safe`."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from tog_mjx.safe import safe_norm


def test_norm_and_its_gradient_are_zero_at_zero():
    value, gradient = jax.value_and_grad(safe_norm)(jnp.zeros(3))
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros(3))
    np.testing.assert_array_equal(jax.jacfwd(safe_norm)(jnp.zeros(3)), np.zeros(3))


def test_norm_elsewhere():
    x = jnp.array([[3.0, 4.0], [-1e-8, 0.0]])
    np.testing.assert_allclose(safe_norm(x), [5, 1e-8])
    check_grads(lambda x: safe_norm(jnp.asarray(x)), (x[0],), order=2, modes=["fwd", "rev"])
