"""Mixes of zeroth and first order, and the alpha-order rule, against closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from quadratic import (
    AT,
    BASELINE,
    FIRST,
    FOURTH,
    KEY,
    KEYS,
    SAMPLES,
    SIGMA,
    SIGMAS,
    SLOPE,
    assert_mean,
    draw,
    jump,
    quadratic,
)

from tog_mjx.gradients import (
    alpha_order,
    alpha_order_mix,
    bernstein_radius,
    first_order,
    mix,
    mixed,
    zeroth_order,
)


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
