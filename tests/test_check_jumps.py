"""Differences that settle twice: what is told of sawtooth functions, steep ones, smooth ones, and touch-downs."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.agreement import agreement, between_jumps, sweep
from tog_mjx.checks.measured.jumps import find_jumps, judge_jumps, lacks
from tog_mjx.checks.told.finding import Finding, Level

GALLERY = Path(__file__).parent / "scenes" / "verdicts"


def saw(x, tooth, rise):
    """x, and a jump by `rise` times `tooth` after each tooth: the slope of the whole is 1 + `rise`."""
    return x[0] + rise * tooth * jnp.floor(x[0] / tooth)


def with_jumps(slope):
    """A saw whose slope is 0.5, with a derivative of one's own."""
    function = jax.custom_jvp(lambda x: saw(x, 1e-3, -0.5))
    function.defjvp(lambda primals, tangents: (function(*primals), slope * tangents[0][0]))
    return function


@pytest.mark.parametrize(
    ("plain", "jumps", "level"), [(1.0, 0.9, Level.CARE), (1.1, 0.0, Level.FAULT), (1.1, 0.9, Level.FAULT)]
)
def test_jumps_that_short_differences_cannot_see_are_no_fault_but_a_wrong_slope_between_them_is(plain, jumps, level):
    """A step of a gradient with jumps, whose one jump is 1e-4 away: differences say 1 at short steps."""
    differences = sweep(lambda x: x + 1e-4 * (x > 1e-4), np.zeros(1), np.eye(1))
    slopes = np.array([[plain + jumps]])
    judged = agreement(slopes, differences)
    assert judged.level == Level.FAULT
    found = between_jumps(judged, slopes, np.array([[plain]]), differences)
    assert found.level == level
    if level == Level.CARE:
        assert "between jumps autodiff agrees with differences to" in found.sentence
        assert "47% of the gradient are jumps" in found.sentence
    else:
        assert found == judged


@pytest.mark.parametrize(
    ("function", "x", "level", "words"),
    [
        (lambda x: saw(x, 1e-4, 10), 0.30003, Level.FAULT, "is 1, but over 0.001 the slope is 11"),
        (lambda x: saw(x, 1e-4, -1.5), 0.30003, Level.FAULT, "is 1, but over 0.001 the slope is -0.502"),
        (lambda x: saw(x, 1e-2, -0.5), 0.30003, Level.FAULT, "the derivative is that between two jumps"),
        (lambda x: saw(x, 1e-3, 0.05), 0.30003, Level.FINE, "no check found a fault"),  # 5 % are felt by nobody.
        (with_jumps(0.5), 0.30003, Level.FINE, "no check found a fault"),
        (with_jumps(0.4), 0.30003, Level.CARE, "has the jumps, as they lie on the grid of time steps"),
        (with_jumps(3.0), 0.30003, Level.FAULT, "autodiff is wrong"),
        (lambda x: x[0] + jnp.tanh(1e4 * x[0]), 0.003, Level.CARE, "the function jumps within 0.03"),
        (lambda x: jnp.tanh(1e4 * x[0]), 0.0, Level.CARE, "over steps of up to 3e-05 of a variable's size only"),
        (lambda x: jnp.floor(3 * x[0]) + x[0], 0.6, Level.CARE, "the function jumps within 0.1"),
        (lambda x: jnp.abs(x[0]) + 2 * x[0], 0.0, Level.CARE, "kink"),
        (lambda x: x[0] + 3e-3 * jnp.sin(300 * x[0]), 0.3005, Level.CARE, "differences settle twice"),
        (lambda x: jnp.sin(x[0]), 0.3, Level.FINE, "no check found a fault"),
        (lambda x: jnp.sin(30 * x[0]) + x[0], 0.3, Level.FINE, "no check found a fault"),
        (lambda x: jnp.exp(30 * x[0]), 0.3, Level.FINE, "no check found a fault"),
        (lambda x: (x[0] - 0.29) ** 2, 0.3, Level.FINE, "no check found a fault"),
        (lambda x: x[0] ** 3 + 1e-3 * x[0], 0.0, Level.FINE, "no check found a fault"),
    ],
)
def test_jumps_are_told_from_curvature(function, x, level, words):
    with jax.enable_x64():
        verdict = tog.check(function, np.array([x]))
    assert (verdict.level, words in verdict.line) == (level, True), verdict.line


@pytest.mark.parametrize("frequency", [1e2, 1e3, 1e4, 1e5])
def test_a_steep_wave_has_no_jumps(frequency):
    """Nor where the points of a window lie more than a period apart."""
    values = lambda points: np.sin(frequency * points)  # noqa: E731
    found = find_jumps(values, np.array([0.3]), np.eye(1), sweep(values, np.array([0.3]), np.eye(1)))
    assert found is None or found.number == 0


def test_each_direction_and_output_is_judged_by_itself():
    """The second output has jumps along the second variable, and is a hundredth of the first."""

    def values(points):
        x, y = points.T
        return np.stack([x + np.sin(y), 1e-2 * (x + y - 0.5 * np.floor(y / 1e-3) * 1e-3)], axis=1)

    point, slopes = np.array([0.2, 0.30003]), np.array([[1.0, np.cos(0.30003)], [1e-2, 1e-2]])
    jumps = find_jumps(values, point, np.eye(2), sweep(values, point, np.eye(2)))
    assert jumps is not None
    assert jumps.entry == (1, 1)
    assert lacks(slopes, jumps)
    np.testing.assert_allclose(jumps.slope, 0.5e-2, rtol=0.05)
    assert jumps.sides is not None
    before, after = jumps.sides
    assert before[0] == after[0] == 0.2
    # The tooth that lies between them.
    assert np.floor(after[1] / 1e-3) == np.floor(before[1] / 1e-3) + 1
    assert after[1] - before[1] < 1e-8
    found = judge_jumps(Finding("agreement", Level.FINE, ""), slopes, jumps, ["x", "y"], ["a", "b"], lambda _: "here")
    assert found.sentence.startswith("the derivative is that between two jumps: d b / d y is 0.01, but over 0.01 the")
    assert found.sentence.endswith("; here")
    assert "saltation" in found.remedy
    plain, scale = Finding("agreement", Level.FINE, ""), np.array([1.0, 20.0])
    found = judge_jumps(plain, slopes, jumps, ["x", "y"], ["a", "b"], scale=scale)
    assert "d b / d y is 0.0005, but over 0.2 the slope is 0.00025" in found.sentence


def values_in_c(model: mujoco.MjModel, steps: int, wrt: str):
    """Of the site, from the keyframe on, by C MuJoCo."""

    def values(points):
        found = []
        for x in points:
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            getattr(data, wrt)[:] += x
            mujoco.mj_step(model, data, steps)
            mujoco.mj_kinematics(model, data)
            found.append(data.site("watched").xpos.copy())
        return np.array(found)

    return values


@pytest.mark.parametrize(
    ("file", "steps", "wrt", "entry", "short", "slope"),
    [
        ("bounce.xml", 150, "qpos", (2, 0), -1.604, 0.2596),
        ("two_balls.xml", 200, "qpos", (0, 0), 2.175, 0.5663),
        ("throw.xml", 320, "qvel", (0, 1), 0.1775, 0.0781),
    ],
)
def test_the_slope_over_a_window_does_not_depend_on_the_time_step(file, steps, wrt, entry, short, slope):
    """`slope` is that of least squares over 801 values within the window, at a quarter of the time step."""
    model = mujoco.MjModel.from_xml_path(str(GALLERY / file))
    values, x, n = values_in_c(model, steps, wrt), np.zeros(model.nv), model.nv
    jumps = find_jumps(values, x, np.eye(n), sweep(values, x, np.eye(n)))
    assert jumps is not None
    assert jumps.are_many
    assert jumps.entry == entry
    np.testing.assert_allclose(jumps.short, short, atol=1e-3)
    # In units of what the derivative errs by.
    np.testing.assert_allclose(jumps.slope, slope, rtol=0, atol=0.05 * abs(slope - short))


@pytest.mark.parametrize("file", ["two_balls.xml", "throw.xml"])
def test_a_force_that_begins_at_zero_mends_it(file):
    """Over more than the travel of a step, that is: over 1 cm, at half a millisecond."""
    model = mujoco.MjModel.from_xml_path(str(GALLERY / file))
    model.geom_solimp[:] = 0, 0.95, 0.01, 0.5, 2
    model.opt.timestep /= 4
    wrt, steps = ("qvel", 1280) if file == "throw.xml" else ("qpos", 800)
    values, x = values_in_c(model, steps, wrt), np.zeros(model.nv)
    assert find_jumps(values, x, np.eye(model.nv), sweep(values, x, np.eye(model.nv))) is None
