"""`tog.check` on functions of one known fault each."""

import json
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.single import judge_single
from tog_mjx.checks.told.finding import Level


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64():
        yield


def smooth(x):
    return jnp.sin(x).sum() + x[0] * x[1]


def bent(x):
    return jnp.abs(x[0]) + x[1]


def nothing_at_zero(x):
    return jnp.sqrt(x[0] ** 2) + x[1]


def dropped(x):
    return jax.lax.stop_gradient(x[0]) ** 2 + x[1]


def unused(x):
    return x[1] ** 2


def flat_here(x):
    return jnp.floor(3 * x[0]) + x[1]


def cubic(x):
    """Of derivative zero at zero, though it moves."""
    return x[0] ** 3 + x[1]


def one_unmoved(x):
    return jnp.stack([x.sum(), 5.0 + 0 * x[0]])


def one_dropped(x):
    """The second output is too small for the size of all to show it."""
    return jnp.stack([1e6 * x.sum(), jax.lax.stop_gradient(x[0]) + 1.0])


def looped(x):
    return jax.lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, s[1] * 1.5), (0, x.sum()))[1]


def cancelling(x):
    """(x - 1)^7, multiplied out: near 1 the terms cancel but for a millionth."""
    return jnp.polyval(jnp.array([1.0, -7, 21, -35, 35, -21, 7, -1]), x[0])


@jax.custom_jvp
def wrong(x):
    return (x**2).sum()


wrong.defjvp(lambda primals, tangents: (wrong(*primals), 2.2 * primals[0] @ tangents[0]))


@jax.custom_jvp
def wrong_at_a_kink(x):
    return jnp.abs(x[0]) + x[1]


wrong_at_a_kink.defjvp(lambda primals, tangents: (wrong_at_a_kink(*primals), 7 * tangents[0][0] + tangents[0][1]))


def flat_at_rest(x):
    """As MJX has what turns or is stretched: below 1e-8 it is flat."""
    return 2 * x[0] + 3 * jnp.sin(jnp.where(jnp.abs(x[0]) <= 1e-8, 0.0, x[0])) + x[1]


@jax.custom_jvp
def mended_at_rest(x):
    return flat_at_rest(x)


mended_at_rest.defjvp(lambda primals, tangents: (mended_at_rest(*primals), 5 * tangents[0][0] + tangents[0][1]))


def drowned(x):
    """As `rough`, with more noise than slope."""
    return x.sum() + jax.lax.stop_gradient(jnp.sin(jnp.sqrt(2.0) * 1e9 * x[0] ** 2))


def rough(x):
    """As autodiff sees a function with noise on it: the noise is not differentiated."""
    return x.sum() + 1e-2 * jax.lax.stop_gradient(jnp.sin(jnp.sqrt(2.0) * 1e9 * x[0] ** 2))


@pytest.mark.parametrize(
    ("function", "x", "level", "check", "words"),
    [
        (smooth, [0.3, 0.7], Level.FINE, None, "no check found a fault"),
        (bent, [0.0, 1.0], Level.CARE, "agreement", "kink"),
        (nothing_at_zero, [0.0, 1.0], Level.FAULT, "finite", "the gradient is NaN or infinite"),
        (dropped, [0.5, 1.0], Level.FAULT, "zeros", "x[0]: autodiff says zero"),
        (
            unused,
            [0.5, 1.0],
            Level.CARE,
            "zeros",
            "1 of 2 derivatives are zero (x[0]): the output does not",
        ),
        (flat_here, [0.6, 1.0], Level.CARE, "zeros", "longer steps only"),
        (cubic, [0.0, 1.0], Level.FINE, None, "no check found a fault"),
        (one_unmoved, [0.5, 1.0], Level.CARE, "zeros", "no variable moves y[1] (1 of 2 outputs): the output does not"),
        (one_dropped, [0.5, 1.0], Level.FAULT, "zeros", "y[1]: autodiff says zero, but differences do not"),
        (looped, [0.5, 1.0], Level.CARE, "reverse mode", "unknown length"),
        (cancelling, [1.05], Level.FAULT, "precision", "float32"),
        (wrong, [0.5, 1.0], Level.FAULT, "agreement", "wrong by 9e-02"),
        (wrong_at_a_kink, [0.0, 1.0], Level.FAULT, "agreement", "autodiff is neither, nor between them"),
        (
            flat_at_rest,
            [0.0, 0.0],
            Level.FAULT,
            "agreement",
            "up to 1e-08 of a variable's size, too short a piece to move on",
        ),
        (mended_at_rest, [0.0, 0.0], Level.FINE, None, "no check found a fault"),
        (drowned, [0.5, 1.0], Level.FAULT, "agreement", "over none of the steps does autodiff come within 10%"),
        (rough, [0.5, 1.0], Level.CARE, "agreement", "never settle"),
    ],
)
def test_each_fault_is_named(function, x, level, check, words):
    verdict = tog.check(function, np.array(x))
    assert verdict.level == level
    assert (verdict.reason.check if verdict.reason else None) == check
    assert words in verdict.line
    pointing = " ".join(some.remedy for some in verdict.findings if some.remedy.startswith("see "))
    assert set(re.findall(r"'([^']+)'", pointing)) <= {some.check for some in verdict.findings}


def test_the_gradient_is_in_the_verdict():
    verdict = tog.check(smooth, np.array([0.3, 0.7]))
    np.testing.assert_allclose(verdict.gradient, [[np.cos(0.3) + 0.7, np.cos(0.7) + 0.3]], rtol=1e-12)
    np.testing.assert_allclose(verdict.value, [np.sin(0.3) + np.sin(0.7) + 0.21], rtol=1e-12)


def test_the_gradient_is_per_unit_of_each_variable_and_beside_it_per_size():
    verdict = tog.check(lambda x: x[0] ** 2 * x[1], np.array([5.0, 0.5]))
    np.testing.assert_allclose(verdict.gradient, [[5.0, 25.0]], rtol=1e-12)
    found = verdict.as_json()
    assert found["scale"] == [5.0, 1.0]
    np.testing.assert_allclose(found["gradient"], [[5.0, 25.0]], rtol=1e-12)
    np.testing.assert_allclose(found["scaled_gradient"], [[25.0, 25.0]], rtol=1e-12)


def test_along_random_directions_it_is_per_unit_of_length():
    weights = np.arange(1.0, 51.0)
    verdict = tog.check(lambda x: x @ weights, np.full(50, 4.0))
    assert len(verdict.scale) == 6
    np.testing.assert_allclose(verdict.scale, 4.0, rtol=1e-12)
    assert np.max(np.abs(verdict.gradient)) <= np.linalg.norm(weights)
    np.testing.assert_allclose(verdict.scaled_gradient, 4 * np.array(verdict.gradient), rtol=1e-12)


def test_a_verdict_in_words_is_what_the_command_prints():
    def lost(x):
        return jax.lax.stop_gradient(x[0]) + x[1]

    found = str(tog.check(lost, np.array([0.5, 1.0]))).splitlines()
    assert found[0] == "fine  finite: value and gradient are finite"
    assert found[1] == "fault zeros: x[0]: autodiff says zero, but differences do not"
    assert found[2].startswith("      the code drops this derivative: of mjx.step differentiate tog.step")
    sentence = "do not trust: x[0]: autodiff says zero, but differences do not"
    assert found[-1] == f"lost in 2 variables: {sentence}"
    assert not any("Finding(" in line or "curves" in line for line in found)


def test_a_function_that_holds_float64_is_not_run_in_float32_and_nothing_warns():
    """As one does that closes over a model of MJX. Half in float32 it would say nothing of either."""
    table, place = jnp.array([1.0, 2.0, 3.0]), jnp.array([0, 2])
    assert table.dtype == jnp.float64

    def held(x):
        return (table.at[place].set(x[:2].astype(table.dtype)) ** 2).sum()

    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        verdict = tog.check(held, np.array([0.5, 1.0]))
    assert [str(some.message) for some in heard] == []
    (found,) = [some for some in verdict.findings if some.check == "precision"]
    assert (found.level, found.value) == (Level.FINE, None)
    assert found.sentence == "not compared: the function holds arrays of float64"


def test_of_many_variables_directions_are_taken():
    verdict = tog.check(lambda x: (x**2).sum(), np.linspace(-1, 1, 50))
    assert verdict.level == Level.FINE
    assert len(verdict.variables) == 6


def test_the_best_step_of_the_v_is_that_of_theory():
    """The error of central differences is h^2 |f'''| / 6 + eps |f| / h, least at about (3 eps)^(1/3) = 9e-6."""
    verdict = tog.check(lambda x: jnp.exp(x[0]), np.array([0.0]))
    curves = next(finding for finding in verdict.findings if finding.check == "agreement").curves
    best = curves["step"][int(np.nanargmin(curves["error"]))]
    assert 1e-6 < best < 1e-4
    np.testing.assert_allclose(curves["error"][0], 0.1**2 / 6, rtol=0.01)


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (np.zeros(0), "x holds no numbers: give a vector of finite numbers, or a pytree"),
        ({"a": (), "b": np.zeros((0, 3))}, "x holds no numbers"),
        (np.array([np.nan]), "x is not finite: give a vector of finite numbers"),
        ({"a": [1.0, "far"]}, r"x\['a'\]\[1\] is of type str: give"),
        ({"a": 1j * np.ones(2)}, r"x\['a'\] is of type complex128: give"),
        ({"a": jax.random.key(0)}, r"x\['a'\] is of type key<fry>: give"),
    ],
)
def test_a_point_that_is_none_is_refused(x, message):
    with pytest.raises(tog.InputError, match=message):
        tog.check(smooth, x)


def test_a_verdict_is_plain_json():
    found = json.loads(json.dumps(tog.check(nothing_at_zero, np.array([0.0, 1.0])).as_json(), allow_nan=False))
    assert found["verdict"] == "do not trust"
    assert found["reason"] == "finite"
    assert found["gradient"] == [[None, None]]
    assert [finding["level"] for finding in found["findings"]][:1] == ["fault"]


@pytest.mark.parametrize(
    ("single", "full", "level", "remedy"),
    [
        (1.0, None, Level.FINE, ""),
        (1.1, None, Level.CARE, "jax_enable_x64"),
        (3.0, None, Level.FAULT, "jax_enable_x64"),
        (3.0, 1.001, Level.FAULT, "jax_default_matmul_precision"),
        (3.0, 2.0, Level.FAULT, "jax_enable_x64"),
        (np.inf, 1.0, Level.FAULT, "jax_enable_x64"),
    ],
)
def test_rounding_is_told_from_rounded_products(single, full, level, remedy):
    found = judge_single(np.ones((2, 2)), np.full((2, 2), single), None if full is None else np.full((2, 2), full))
    assert found.level == level
    assert remedy in found.remedy


def test_a_branch_that_is_not_taken_spoils_reverse_mode_and_is_told():
    """As in rewards whose bound may be infinite: the derivative of what is not chosen is 0 times infinity."""

    def reward(x):
        return jnp.where(x[0] > 1.2, x[0], jnp.exp(-((x[0] - jnp.inf) ** 2)))

    assert jnp.isnan(jax.grad(reward)(jnp.array([1.3]))).all()
    (found,) = [some for some in tog.check(reward, [1.3]).findings if some.level == Level.FAULT]
    assert found.check == "reverse mode"
    assert "jnp.where" in found.remedy
