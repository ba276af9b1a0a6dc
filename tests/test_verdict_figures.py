"""The figures of a verdict: what a number alone cannot say, and no flat curve."""

import numpy as np
import pytest

from tog_mjx.checks.measured.agreement import agreement, sweep
from tog_mjx.checks.measured.jumps import find_jumps, judge_jumps
from tog_mjx.checks.told.finding import Level
from tog_mjx.drawing.figures.curves import figures, informative
from tog_mjx.drawing.report.verdict_page import write_verdict

STEPS = list(range(20))
FALLING = [0.5**k for k in STEPS]


def drawn(check: str, level: str, **curves) -> dict[str, dict[str, np.ndarray]]:
    """The lines of each figure by their labels."""
    named = {name.replace("_", " "): curve for name, curve in curves.items()}
    return {
        some.name: {str(line.get_label()): np.asarray(line.get_ydata(), float) for line in some.figure.axes[0].lines}
        for some in figures(check, level, named)
    }


@pytest.mark.parametrize(
    ("curve", "is_shown"),
    [
        (FALLING, True),
        ([1.0] * 20, False),
        ([0.0] * 20, False),
        ([1 + 1e-3 * k for k in STEPS], False),
        ([1 + 1e-1 * k for k in STEPS], True),
        ([None] * 18 + [1.0, 2.0], False),
        ([float("inf")] * 10 + FALLING[:10], True),
    ],
)
def test_a_curve_is_drawn_where_it_is_not_flat(curve, is_shown):
    found = drawn("growth", "fine", step=STEPS, largest_singular_value=curve)
    assert found.keys() == ({"growth"} if is_shown else set())
    if is_shown:
        expected = np.array([np.nan if x is None or not np.isfinite(x) else x for x in curve], float)
        np.testing.assert_array_equal(found["growth"]["largest singular value"], expected)


def test_of_curves_on_one_line_one_is_drawn():
    same = {"largest_singular_value": FALLING, "smallest_singular_value": [1.001 * y for y in FALLING]}
    found = drawn("growth", "care", step=STEPS, **same, derivative_along_direction_0=FALLING[::-1])
    assert list(found["growth"]) == ["largest singular value", "derivative along direction 0"]


def test_rounding_is_not_drawn():
    rounding = [1e-15 * (1 + k) for k in STEPS]
    assert not drawn("parity", "care", step=STEPS, difference_of_a_step=rounding)
    assert drawn("parity", "care", step=STEPS, difference_of_a_step=[1e3 * y for y in rounding])


@pytest.mark.parametrize("check", ["agreement", "time step", "solver", "parity", "estimators"])
def test_what_a_sentence_calls_fine_has_no_figure(check):
    curves: dict[str, list] = {
        "step": STEPS,
        "error": FALLING,
        "time step, relative": STEPS,
        "gradient norm": FALLING,
        "sigma": STEPS,
    }
    curves |= {"iterations": STEPS, "difference of a step": FALLING, "error, exact": FALLING}
    assert informative(check, "fault", curves)
    assert not informative(check, "fine", curves)


def test_three_numbers_that_the_sentence_says_have_no_figure():
    assert not figures("stiffness", "care", {"stiffness, relative": [0.25, 1, 4], "gradient norm": [1, 2, 3]})
    assert not figures("time step", "care", {"time step, relative": [1, 0.5, 0.25], "gradient norm": [1, 2, 3]})


def staircase(points: np.ndarray) -> np.ndarray:
    """Falls by 1 on average, and rises by 0.5 between its steps."""
    return 0.5 * points - 1.5 / 40 * np.floor(40 * points + 0.37)


def test_a_function_between_jumps_is_drawn_beside_its_derivative_and_its_slope():
    x, directions, slopes = np.array([0.2]), np.array([[2.0]]), np.array([[1.0]])
    differences = sweep(staircase, x, directions)
    plain = agreement(slopes, differences)
    jumps = find_jumps(staircase, x, directions, differences)
    judged = judge_jumps(plain, slopes, jumps, ["u"], ["y"], scale=np.array([2.0]))
    assert judged.level == Level.FAULT
    curves = {name: np.array(curve, float) for name, curve in judged.curves.items()}
    assert len({len(curve) for curve in curves.values()}) == 1
    seen = np.isfinite(curves["displacement"])
    at = curves["displacement"][seen]
    middle = np.abs(at).argmin()
    values = staircase(x + at)
    np.testing.assert_allclose(curves["function"][seen], values - values[middle], atol=1e-12)
    np.testing.assert_allclose(curves["along the gradient"][seen], 0.5 * (at - at[middle]), atol=1e-12)
    slope = np.diff(curves["along the slope over the window"][seen]) / np.diff(at)
    np.testing.assert_allclose(slope, -1, atol=0.2)
    assert [some.name for some in figures(judged.check, "fault", judged.curves)] == [
        "agreement",
        "agreement, along a line",
    ]


def test_a_page_has_the_figures_and_no_empty_section(tmp_path):
    finding = {"check": "growth", "level": "fine", "sentence": "it grows", "value": 1.0, "remedy": ""}
    verdict = {"verdict": "trust", "subject": "x", "outputs": ["y"], "variables": ["u"], "value": [1.0]}
    verdict |= {"gradient": [[2.0]], "scale": [1.0]}
    for curve, count in ((FALLING, 1), ([1.0] * 20, 0)):
        curves = {"step": STEPS, "largest singular value": curve}
        write_verdict(tmp_path / "a.html", "a", "trust", {**verdict, "findings": [{**finding, "curves": curves}]})
        page = (tmp_path / "a.html").read_text()
        assert page.count("<img ") == page.count(">Curves<") == count
