"""The randomised estimators, and differences, against closed forms.

A mean over KEYS independent estimates is held to SIGMAS standard errors of it, from the variance in closed form.
"""

import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tog_mjx.errors import InputError
from tog_mjx.gradients import (
    Estimator,
    alpha_order,
    alpha_order_mix,
    bernstein_radius,
    central_differences,
    exact,
    first_order,
    mix,
    mixed,
    stochastic,
    zeroth_order,
)

A = jnp.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.7], [0.0, -0.7, 3.0]])
B = jnp.array([1.0, -3.0, 0.5])
AT = jnp.array([0.3, -0.2, 0.9])
SLOPE = A @ AT + B
N_VARIABLES = AT.size
FOURTH = float(jnp.trace(A) ** 2 + 2 * jnp.sum(A**2))
"""E (w^T A w)^2 / sigma^4."""
SIGMA = 0.4
SAMPLES = 8
KEYS = 20_000
SIGMAS = 5
KEY = jax.random.key(7)


def quadratic(u):
    return 0.5 * u @ A @ u + B @ u


def jump(u):
    return jnp.where(u[0] > 0, 1.0, 0.0)


def density(x):
    return math.exp(-(x**2) / 2) / math.sqrt(2 * math.pi)


COST = float(quadratic(AT))
FIRST = SIGMA**2 * float(jnp.sum(A**2))
ANTITHETIC = (N_VARIABLES + 1) * float(SLOPE @ SLOPE)
BASELINE = ANTITHETIC + SIGMA**2 * (N_VARIABLES + 4) * FOURTH / 4
PLAIN = BASELINE + N_VARIABLES * COST**2 / SIGMA**2 + (N_VARIABLES + 2) * COST * float(jnp.trace(A))
"""Traces of the covariance of one sample, of the quadratic at AT."""

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


def draw(estimate, u, keys=KEYS):
    """Estimates under many keys."""
    return jax.jit(jax.vmap(estimate, (0, None)))(jax.random.split(KEY, keys), u)[1]


def assert_mean(estimates, expected, variance):
    """`variance`: the trace of the covariance of one estimate, or a bound of it."""
    error = np.linalg.norm(estimates.mean(0) - expected)
    assert error < SIGMAS * math.sqrt(variance / len(estimates))


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


def test_a_mix_is_of_the_two_orders_under_its_key():
    found = mix(quadratic, SIGMA, SAMPLES)(KEY, AT)[1]
    zeroth = zeroth_order(quadratic, SIGMA, SAMPLES)(KEY, AT)[1]
    first = first_order(quadratic, SIGMA, SAMPLES)(KEY, AT)[1]
    assert 0 < found.alpha < 1
    np.testing.assert_allclose(found.gradient, found.alpha * first + (1 - found.alpha) * zeroth, rtol=1e-12)
    weight = found.variance_zeroth / (found.variance_zeroth + found.variance_first)
    np.testing.assert_allclose(found.alpha, weight, rtol=1e-15)
    np.testing.assert_array_equal(mixed(quadratic, SIGMA, SAMPLES)(KEY, AT)[1], found.gradient)


def test_recorded_variances_are_unbiased():
    found = draw(mix(quadratic, SIGMA, SAMPLES), AT)
    for variances, expected in ((found.variance_zeroth, BASELINE), (found.variance_first, FIRST)):
        assert abs(variances.mean() - expected / SAMPLES) < SIGMAS * variances.std() / math.sqrt(KEYS)


def test_variance_of_a_mix_on_a_quadratic():
    # With many samples the weight is nearly constant, and the variance what its covariance C makes of it.
    samples, keys = 400, 4000
    found = draw(mix(quadratic, SIGMA, samples), AT, keys)
    covariance = SIGMA**2 * FOURTH / 2
    alpha = BASELINE / (BASELINE + FIRST)
    np.testing.assert_allclose(found.alpha.mean(), alpha, rtol=1e-3)
    expected = (alpha**2 * FIRST + (1 - alpha) ** 2 * BASELINE + 2 * alpha * (1 - alpha) * covariance) / samples
    squares = np.sum((found.gradient - SLOPE) ** 2, 1)
    error = SIGMAS * squares.std() / math.sqrt(keys)
    assert abs(squares.mean() - expected) < error
    np.testing.assert_allclose(found.variance.mean(), expected, rtol=0.01)
    assert squares.mean() + error < BASELINE / samples
    # And no less than first order alone: the two orders share their points.
    assert found.variance.mean() > FIRST / samples


def test_a_mix_of_uncorrelated_orders_has_less_variance_than_either():
    # A slope with ripples: under w of their length the two orders are nearly uncorrelated, and V0 is near V1.
    def ripples(u):
        return u[0] + jnp.sin(3 * u[0])

    u = jnp.zeros(1)
    samples = 64
    x, weights = np.polynomial.hermite_e.hermegauss(80)
    weights /= weights.sum()
    mean = weights @ (1 + 3 * np.cos(3 * x))
    gradients = {
        "zeroth": draw(zeroth_order(ripples, 1.0, samples), u),
        "first": draw(first_order(ripples, 1.0, samples), u),
        "mixed": draw(mixed(ripples, 1.0, samples), u),
    }
    terms = {"zeroth": (x + np.sin(3 * x)) * x - mean, "first": 1 + 3 * np.cos(3 * x) - mean}
    for name, term in terms.items():
        assert_mean(gradients[name], mean, weights @ term**2 / samples)
    variances = {name: found.var() for name, found in gradients.items()}
    # A variance of KEYS near-normal numbers is known to sqrt(2 / KEYS).
    assert variances["mixed"] * (1 + SIGMAS * math.sqrt(2 / KEYS)) < min(variances["zeroth"], variances["first"])


def test_a_mix_without_variance_is_of_first_order():
    found = mix(lambda u: 0 * u.sum() + 2.0, SIGMA, SAMPLES)(KEY, AT)[1]
    assert found.alpha == 1
    assert found.variance == found.variance_zeroth == found.variance_first == 0
    np.testing.assert_array_equal(found.gradient, 0)


def test_the_radius_is_the_solution_of_bernsteins_inequality():
    terms = jnp.array(np.random.default_rng(3).normal(size=(50, 2)))
    confidence = 0.95
    radius = float(bernstein_radius(terms, confidence))
    trace = np.trace(np.cov(terms.T))
    reach = np.linalg.norm(terms - terms.mean(0), axis=1).max()
    exponent = -50 * radius**2 / (2 * trace + 2 * reach * radius / 3)
    np.testing.assert_allclose(3 * math.exp(exponent), 1 - confidence, rtol=1e-9)


def test_the_radius_covers_the_error_as_often_as_it_says_and_is_of_its_size():
    confidence = 0.8

    def error_and_radius(key):
        terms = jax.random.normal(key, (20, 2))
        return jnp.linalg.norm(terms.mean(0)), bernstein_radius(terms, confidence)

    errors, radii = jax.vmap(error_and_radius)(jax.random.split(KEY, 2000))
    assert (errors < radii).mean() > confidence
    assert np.median(radii) < 4 * np.quantile(errors, confidence)


def test_the_alpha_order_falls_back_to_zeroth_order_at_a_jump():
    u = jnp.array([0.25])
    samples = 400
    zeroth = zeroth_order(jump, SIGMA, samples)(KEY, u)[1]
    assert zeroth[0] > 0.5
    assert mix(jump, SIGMA, samples)(KEY, u)[1].alpha == 1  # Which is biased: its gradient is zero.
    np.testing.assert_allclose(alpha_order(jump, SIGMA, samples, 0.95, 0.1)(KEY, u)[1], zeroth, rtol=1e-12)
    # Between the two, the difference allowed is used up.
    threshold = 0.6
    found = alpha_order_mix(jump, SIGMA, samples, 0.95, threshold)(KEY, u)[1]
    assert 0 < found.alpha < 1
    radius = threshold - abs(found.gradient[0] - zeroth[0])
    crossed = float(u[0]) + SIGMA * jax.random.normal(KEY, (samples, 1)) < 0
    terms = jnp.where(crossed, -jax.random.normal(KEY, (samples, 1)) / SIGMA, 0)
    np.testing.assert_allclose(radius, bernstein_radius(terms, 0.95), rtol=1e-9)


def test_the_alpha_order_stays_with_first_order_on_a_quadratic():
    samples = 4000
    record = mix(quadratic, SIGMA, samples)(KEY, AT)[1]
    found = alpha_order_mix(quadratic, SIGMA, samples, 0.95, 3.0)(KEY, AT)[1]
    assert found.alpha > 0.9
    for a, b in zip(found, record, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_alpha_order_without_a_limit_is_the_mix():
    found = alpha_order(jump, SIGMA, SAMPLES, 0.95, float("inf"))(KEY, jnp.array([0.1]))[1]
    np.testing.assert_array_equal(found, mixed(jump, SIGMA, SAMPLES)(KEY, jnp.array([0.1]))[1])


def test_equal_orders_leave_the_alpha_order_finite():
    found = alpha_order_mix(lambda u: 0 * u.sum() + 2.0, SIGMA, SAMPLES, 0.95, 1e-3)(KEY, AT)[1]
    assert found.alpha == 1
    np.testing.assert_array_equal(found.gradient, 0)


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
