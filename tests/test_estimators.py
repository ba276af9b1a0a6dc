"""The randomised estimators, and differences, against closed forms; what all estimators share."""

import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quadratic import (
    ANTITHETIC,
    AT,
    BASELINE,
    FIRST,
    KEY,
    KEYS,
    N_VARIABLES,
    PLAIN,
    SAMPLES,
    SIGMA,
    SIGMAS,
    SLOPE,
    A,
    B,
    assert_mean,
    density,
    draw,
    jump,
    quadratic,
)

from tog_mjx.gradients import (
    Estimator,
    alpha_order,
    central_differences,
    exact,
    first_order,
    mixed,
    stochastic,
    zeroth_order,
)
from tog_mjx.running.errors import InputError

SMOOTHED = {
    "zeroth": (functools.partial(zeroth_order, sigma=SIGMA, samples=SAMPLES), BASELINE),
    "plain": (functools.partial(zeroth_order, sigma=SIGMA, samples=SAMPLES, baseline=False), PLAIN),
    "antithetic": (functools.partial(zeroth_order, sigma=SIGMA, samples=SAMPLES, antithetic=True), ANTITHETIC),
    "first": (functools.partial(first_order, sigma=SIGMA, samples=SAMPLES), FIRST),
}
ALL: dict[str, Callable[..., Estimator]] = {name: make for name, (make, _) in SMOOTHED.items()} | {
    "exact": exact,
    "stochastic": functools.partial(stochastic, sigma=SIGMA),
    "differences": functools.partial(central_differences, step=1e-3),
    "mixed": functools.partial(mixed, sigma=SIGMA, samples=SAMPLES),
    "alpha": functools.partial(alpha_order, sigma=SIGMA, samples=SAMPLES, confidence=0.9, threshold=60.0),
}


@pytest.mark.parametrize("name", ALL)
def test_every_estimator_is_compiled_and_batched(name):
    estimate = ALL[name](quadratic)
    keys, points = jax.random.split(KEY, 3), AT + jnp.arange(3.0)[:, None]
    costs, gradients = jax.jit(jax.vmap(estimate))(keys, points)
    np.testing.assert_allclose(costs, [quadratic(u) for u in points], rtol=1e-14)
    for key, u, gradient in zip(keys, points, gradients, strict=True):
        np.testing.assert_allclose(estimate(key, u)[1], gradient, rtol=1e-10)
    assert len(np.unique(gradients[:, 0])) == 3


@pytest.mark.parametrize("name", [name for name in ALL if name not in ("exact", "differences")])
def test_sigma_may_be_traced(name):
    make = ALL[name]
    sweep = jax.jit(jax.vmap(lambda sigma: make(quadratic, sigma=sigma)(KEY, AT)[1]))(jnp.array([0.1, SIGMA]))
    np.testing.assert_allclose(sweep, [make(quadratic, sigma=s)(KEY, AT)[1] for s in (0.1, SIGMA)], rtol=1e-10)


def test_a_step_may_be_traced():
    gradient = jax.jit(lambda step: central_differences(quadratic, step)(KEY, AT)[1])(jnp.array(0.5))
    np.testing.assert_allclose(gradient, SLOPE, rtol=1e-13)


def test_settings_of_the_alpha_order_may_be_traced():
    @jax.jit
    def sweep(confidence, threshold):
        return alpha_order(quadratic, SIGMA, SAMPLES, confidence, threshold)(KEY, AT)[1]

    for threshold in (10.0, 19.0, 1e3):  # Zeroth order, between the two, and the mix.
        expected = alpha_order(quadratic, SIGMA, SAMPLES, 0.8, threshold)(KEY, AT)[1]
        np.testing.assert_allclose(sweep(jnp.array(0.8), jnp.array(threshold)), expected, rtol=1e-12)


@pytest.mark.parametrize("name", SMOOTHED)
def test_mean_and_variance_on_a_quadratic(name):
    make, variance = SMOOTHED[name]
    gradients = draw(make(quadratic), AT)
    assert_mean(gradients, SLOPE, variance / SAMPLES)
    squares = np.sum((gradients - SLOPE) ** 2, 1)
    assert abs(squares.mean() - variance / SAMPLES) < SIGMAS * squares.std() / math.sqrt(KEYS)


def test_variance_of_zeroth_order_on_a_line():
    # (B . w) w / sigma^2 has the covariance B B^T + |B|^2 I, whatever sigma.
    gradients = draw(zeroth_order(lambda u: B @ u, 0.01, 1), AT)
    expected = jnp.outer(B, B) + B @ B * jnp.eye(N_VARIABLES)
    products = (gradients - B)[:, :, None] * (gradients - B)[:, None, :]
    assert (np.abs(products.mean(0) - expected) < SIGMAS * products.std(0) / math.sqrt(KEYS)).all()


def test_opposite_perturbations_cancel_curvature():
    minimum = -jnp.linalg.solve(A, B)
    np.testing.assert_allclose(zeroth_order(quadratic, SIGMA, SAMPLES, antithetic=True)(KEY, minimum)[1], 0, atol=1e-13)
    assert np.linalg.norm(zeroth_order(quadratic, SIGMA, SAMPLES)(KEY, minimum)[1]) > 0.1


def test_one_sample_of_zeroth_order_is_the_normalised_rule_of_the_paper():
    expected = stochastic(quadratic, SIGMA, normalised=True)(KEY, AT)
    for found, value in zip(zeroth_order(quadratic, SIGMA, 1)(KEY, AT), expected, strict=True):
        np.testing.assert_allclose(found, value, rtol=1e-12)


def test_a_jump_is_seen_by_zeroth_order_alone():
    u = jnp.array([0.25])
    a = float(u[0]) / SIGMA
    mean = density(a) / SIGMA
    # E w^2 where w < -u, over sigma^4, less the mean's square.
    variance = (0.5 * math.erfc(a / math.sqrt(2)) + a * density(a)) / SIGMA**2 - mean**2
    zeroth = draw(zeroth_order(jump, SIGMA, SAMPLES), u)
    assert_mean(zeroth, mean, variance / SAMPLES)
    assert SIGMAS * math.sqrt(variance / SAMPLES / KEYS) < mean / 10  # The bias of first order is far outside.
    assert (draw(first_order(jump, SIGMA, SAMPLES), u) == 0).all()


@pytest.mark.parametrize("u", [0.3, -0.1])
def test_a_kink_is_smoothed_by_both_orders(u):
    at = jnp.array([u])
    mean = math.erf(u / (SIGMA * math.sqrt(2)))

    def kink(u):
        return jnp.abs(u[0])

    assert_mean(draw(first_order(kink, SIGMA, SAMPLES), at), mean, (1 - mean**2) / SAMPLES)
    # | |u + w| - |u| | <= |w|, so that the second moment is at most E w^4 / sigma^4 = 3.
    assert_mean(draw(zeroth_order(kink, SIGMA, SAMPLES), at), mean, (3 - mean**2) / SAMPLES)
    assert exact(kink)(KEY, at)[1] == np.sign(u)


@pytest.mark.parametrize("step", [1.0, 1e-3])
def test_central_differences_are_exact_on_a_quadratic(step):
    gradient = central_differences(quadratic, step)(KEY, AT)[1]
    np.testing.assert_allclose(gradient, SLOPE, atol=20 * np.finfo(float).eps / step)


@pytest.mark.parametrize("step", [0.1, 0.01])
def test_central_differences_are_off_by_the_third_derivative(step):
    gradient = central_differences(lambda u: jnp.sum(u**3), step)(KEY, AT)[1]
    np.testing.assert_allclose(gradient - 3 * AT**2, step**2, rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: zeroth_order(quadratic, 0.0, 1), "sigma is 0.0"),
        (lambda: zeroth_order(quadratic, jnp.array(-1.0), 1), "sigma is -1.0"),
        (lambda: zeroth_order(quadratic, 1.0, 0), "samples is 0: the estimate needs at least 1"),
        (lambda: first_order(quadratic, float("nan"), 1), "sigma is nan"),
        (lambda: first_order(quadratic, 1.0, 0), "samples is 0"),
        (lambda: mixed(quadratic, float("inf"), 2), "sigma is inf"),
        (lambda: mixed(quadratic, 1.0, 1), "samples is 1: the estimate needs at least 2"),
        (lambda: central_differences(quadratic, 0.0), "step is 0.0"),
        (lambda: alpha_order(quadratic, 1.0, 1, 0.9, 1.0), "samples is 1"),
        (lambda: alpha_order(quadratic, 1.0, 2, 1.0, 1.0), "confidence is 1.0"),
        (lambda: alpha_order(quadratic, 1.0, 2, 0.9, 0.0), "threshold is 0.0"),
        (lambda: alpha_order(quadratic, 1.0, 2, 0.9, float("nan")), "threshold is nan"),
    ],
)
def test_meaningless_settings_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_known_sigma_is_checked_inside_a_compiled_function():
    # There an operation of a known array is traced, and its truth not known.
    sigma = jnp.array(-1.0)
    with pytest.raises(InputError, match="sigma is"):
        jax.jit(lambda u: first_order(quadratic, sigma, 1)(KEY, u))(AT)
