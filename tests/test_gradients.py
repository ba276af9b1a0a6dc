"""The estimators against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tog_mjx.gradients import exact, exact_batch, stochastic

HESSIAN = jnp.array([[2.0, 0.5], [0.5, 1.0]])
SLOPE = jnp.array([1.0, -3.0])
AT = jnp.array([0.3, -0.2])
KEY = jax.random.key(1)
SAMPLES = 200_000


def quadratic(u):
    return 0.5 * u @ HESSIAN @ u + SLOPE @ u


@pytest.mark.parametrize("mode", ["forward", "reverse", None])
def test_exact(mode):
    cost, gradient = jax.jit(exact(quadratic, mode))(KEY, AT)
    np.testing.assert_allclose(cost, quadratic(AT), rtol=1e-14)
    np.testing.assert_allclose(gradient, HESSIAN @ AT + SLOPE, rtol=1e-14)


def test_exact_with_many_variables():
    u = jnp.arange(7.0)
    np.testing.assert_allclose(exact(lambda u: jnp.sum(u**2))(KEY, u)[1], 2 * u)


@pytest.mark.parametrize("normalised", [False, True])
def test_stochastic_has_the_mean_of_the_papers_rule(normalised):
    # E[(J(u + w) - J(u)) w] = sigma^2 grad J for a quadratic: odd moments of w vanish.
    sigma = 0.3
    estimate = stochastic(quadratic, sigma, normalised)
    costs, gradients = jax.jit(jax.vmap(estimate, (0, None)))(jax.random.split(KEY, SAMPLES), AT)
    np.testing.assert_allclose(costs, quadratic(AT), rtol=1e-14)
    expected = (HESSIAN @ AT + SLOPE) * (1 if normalised else sigma**2)
    error = gradients.std(0) / np.sqrt(SAMPLES)
    assert (np.abs(gradients.mean(0) - expected) < 5 * error).all()


def test_stochastic_has_the_variance_of_a_linear_cost():
    # With J = s . u the estimate is (s . w) w, whose covariance is sigma^4 (s s^T + |s|^2 I).
    sigma = 0.5
    estimate = stochastic(lambda u: SLOPE @ u, sigma)
    gradients = jax.vmap(estimate, (0, None))(jax.random.split(KEY, SAMPLES), AT)[1]
    expected = sigma**4 * (jnp.outer(SLOPE, SLOPE) + SLOPE @ SLOPE * jnp.eye(2))
    # Fourth moments of products of normals bound the error of a covariance to a few times its size over sqrt(samples).
    np.testing.assert_allclose(np.cov(gradients.T), expected, atol=30 * float(expected.max()) / np.sqrt(SAMPLES))


def test_stochastic_takes_a_cost_without_a_derivative():
    cost, gradient = stochastic(lambda u: jnp.where(u[0] > 0, 1.0, 0.0), 0.1)(KEY, jnp.array([1e-9]))
    w = 0.1 * jax.random.normal(KEY, (1,))
    assert cost == 1
    np.testing.assert_allclose(gradient, jnp.where(w + 1e-9 > 0, 0, -w))


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), float("inf")])
def test_a_meaningless_sigma_is_refused(sigma):
    with pytest.raises(ValueError, match="sigma is"):
        stochastic(quadratic, sigma)


def test_a_traced_sigma_is_the_same_sigma():
    for normalised in (False, True):
        traced = jax.jit(lambda sigma, n=normalised: stochastic(quadratic, sigma, n)(KEY, AT)[1])(jnp.array(0.3))
        np.testing.assert_allclose(traced, stochastic(quadratic, 0.3, normalised)(KEY, AT)[1], rtol=1e-14)


def test_a_batch_of_exact_gradients_is_that_of_each():
    def objective(u):
        return jnp.sin(u[0]) * u[1] ** 2 + u[2]

    points = jnp.array(np.random.default_rng(0).normal(size=(5, 3)))
    costs, slopes = exact_batch(objective)(points)
    np.testing.assert_allclose(costs, jax.vmap(objective)(points), rtol=1e-15)
    np.testing.assert_allclose(slopes, jax.vmap(jax.grad(objective))(points), rtol=1e-14)
