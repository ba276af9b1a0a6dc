"""Which gradient to follow: the comparison of estimators against closed forms, and on a scene."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured import cost
from tog_mjx.checks.measured.estimators import SIGMAS, compare_at
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.gradients import local

SLOPE = np.array([3.0, -4.0, 1.0])


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64():
        yield


def estimators_of(function, x) -> Finding:
    findings = tog.check(function, x, estimators=True).findings
    return next(finding for finding in findings if finding.check == "estimators")


@pytest.mark.parametrize("sigma", SIGMAS)
def test_of_a_quadratic_every_number_is_known(sigma):
    """J = b x + a |x|^2 / 2: smoothing changes no gradient, first order has the variance n (a sigma)^2."""
    a, n = 2.0, 3
    found = compare_at(lambda x: x @ SLOPE + a * (x**2).sum(1) / 2, lambda x: SLOPE + a * x, n, sigma, charge=4)
    assert found.bias_exact < 1e-10
    assert found.noise < 1e-10
    assert found.bias_first == pytest.approx(0, abs=4 * (n / 64) ** 0.5 * a * sigma / 26**0.5)
    assert found.variance_first == pytest.approx(n * (a * sigma) ** 2, rel=0.3)
    trace = 2 * n + n**2
    assert found.variance_zeroth == pytest.approx((n + 1) * 26 + sigma**2 * (n + 4) * trace * a**2 / 4, rel=0.3)
    assert found.snr_zeroth == pytest.approx(0.5, abs=0.1)
    length = sigma * n**0.5
    assert found.gains["exact"] == pytest.approx(length * 26**0.5 - a * length**2 / 2)
    assert found.exact_wins == 1
    assert found.follow == "exact"


def step(x):
    """A step of 1 at 0, which autodiff cannot see, on a slope that leads away from it."""
    return jnp.where(x[0] > 0, 1.0, 0.0) - 1e-3 * x[0] + 1e-3 * x[1] ** 2


def ripple(x):
    """A parabola under steep ripples, far shorter than all but the least perturbation."""
    return (x**2).sum() + 1e-3 * jnp.sin(1e5 * x).sum()


def root(x):
    """Of infinite slope at 0."""
    return jnp.sqrt(jnp.abs(x[0])) + x[0] + x[1] ** 2


def test_across_a_step_zeroth_order_leads():
    found = estimators_of(step, [0.005, 0.3])
    assert "the exact gradient over steps of 0.001; zeroth order over steps of 0.01, 0.1" in found.sentence
    np.testing.assert_allclose(found.curves["error, first order"][1:], 1, atol=1e-2)
    assert found.level == Level.CARE
    assert (
        "within perturbations of 0.01 the value jumps, or rises more" in found.sentence
    )  # First order misses all of the step.
    # The smoothed step has the slope of the normal density: phi(0.005 / sigma) / sigma.
    assert found.curves["gain, zeroth order"][1] == pytest.approx(1, abs=1e-3)


def test_a_steep_rise_is_not_called_a_jump():
    """None of the gradients meets it: they cannot tell."""
    found = estimators_of(lambda x: jnp.tanh(1e4 * x[0]) - x[0], [0.05])
    assert found.level == Level.CARE
    assert (
        "within perturbations of 0.1 the value jumps, or rises more steeply than 64 gradients can see" in found.sentence
    )
    assert found.curves["error, first order"][2] > 1


def test_what_is_not_resolved_is_not_judged():
    """Smoothed over a hundred periods, a sine has no slope at all, and any advice would be by chance."""
    found = estimators_of(lambda x: jnp.sin(1e6 * x).sum(), [0.3, 0.4])
    assert found.level == Level.FINE
    assert (
        "follow what cannot be told (the smoothed gradient is not resolved from zero) at every scale" in found.sentence
    )
    assert min(found.curves["error not resolved"]) > 1 / 4


def test_a_pair_counts_once_in_signal_to_noise():
    """Of a linear J it is 1 / sqrt(n + 1) however many the variables. Both halves of an antithetic pair are the same
    sample there: counted twice, their noise would pass for signal, 0.067."""
    n = 400
    slope = np.random.default_rng(1).normal(size=n)
    found = compare_at(lambda x: x @ slope, lambda x: np.tile(slope, (len(x), 1)), n, 0.1, 1)
    assert found.snr_zeroth == pytest.approx((n + 1) ** -0.5, rel=0.15)


@pytest.mark.parametrize(("x", "counted"), [([0.5, 0.4], 3), ([0.5] * 6, 4)])
def test_a_busy_machine_gives_the_same_advice(x, counted, monkeypatch):
    """In forward mode a gradient counts as a value and one more for each variable, in reverse mode as four."""

    def timed(values: float, gradients: float) -> Finding:
        clock = iter(np.cumsum([0, values, 0, gradients]))
        monkeypatch.setattr(cost, "time", SimpleNamespace(perf_counter=lambda: float(next(clock))))
        return estimators_of(ripple, x)

    quiet, busy = timed(1.0, 3.5), timed(2.0, 50.0)
    assert (quiet.level, quiet.value, quiet.curves) == (busy.level, busy.value, busy.curves)
    assert quiet.sentence.replace("3.5 were measured", "25 were measured") == busy.sentence
    assert f"each counted as {counted} values; 3.5 were measured" in quiet.sentence


def test_among_ripples_averages_lead():
    found = estimators_of(ripple, [0.5, 0.4])
    assert found.level == Level.CARE
    assert "the exact gradient is a poor guide" in found.sentence
    assert "follow the exact gradient" not in found.sentence


def test_where_the_gradient_is_not_finite_values_still_lead():
    found = estimators_of(root, [0.0, 1.0])
    assert found.level == Level.CARE
    assert "zeroth order" in found.sentence
    assert found.curves["gain, exact"] == [0, 0, 0]


def test_on_a_plain_there_is_nothing_to_follow():
    found = estimators_of(lambda x: 0 * x.sum(), [0.3, 0.4])
    assert (found.level, "none (no step lowers it) at every scale" in found.sentence) == (Level.FINE, True)


def test_of_many_variables_and_outputs_the_steepest_is_lowered():
    found = estimators_of(lambda x: jnp.stack([x.sum(), 5 * x.sum()]), np.linspace(0, 1, 10))
    assert "to lower y[1] follow the exact gradient" in found.sentence
    assert found.curves["error, exact"] == pytest.approx([0, 0, 0], abs=1e-10)


def test_a_gradient_that_lacks_jumps_is_not_praised():
    """A step along it gains as much as one along the slope, which has its sign: but it is that of the teeth of a saw,
    and of the output whose gradient it is."""
    tooth = 1e-4
    found = tog.check(
        lambda x: jnp.stack([5 * x[0], x[0] - 0.5 * tooth * jnp.floor(x[0] / tooth)]), [0.30003], estimators=True
    )
    assert "d y[1] / d x[0] is 1, but over" in found.line
    told = found.findings[-1]
    assert (told.check, told.level) == ("estimators", Level.CARE)
    assert "to lower y[1] follow zeroth order at every scale tried" in told.sentence
    assert "differentiation='saltation'" in told.remedy


def test_the_linear_part_is_known_without_noise():
    normals = np.random.default_rng(0).normal(size=(256, 3))
    found = compare_at(lambda x: x @ SLOPE, lambda x: np.tile(SLOPE, (len(x), 1)), 3, 0.1, 1)
    plain = local.noise_of_mean(local.zeroth_terms(0.1 * normals @ SLOPE, normals, 0.1))
    assert found.noise < 1e-12 < plain


ARM = """
<mujoco>
  <worldbody>
    <body><joint name="hinge" axis="0 1 0" damping="1"/><geom size="0.1" pos="0 0 -0.5" mass="1"/></body>
  </worldbody>
  <actuator><motor joint="hinge"/></actuator>
</mujoco>
"""


def test_of_a_scene_the_same_is_asked():
    """A hinge driven for a time too short to swing back: nearly linear in its control."""
    model = mujoco.MjModel.from_xml_string(ARM)
    verdict = tog.check_scene(model, steps=10, quick=True, estimators=True)
    found = verdict.findings[-1]
    assert (found.check, found.level) == ("estimators", Level.FINE)
    assert "to lower qpos[0] follow the exact gradient at every scale tried" in found.sentence
    assert found.curves["error, exact"][0] < 1e-6
