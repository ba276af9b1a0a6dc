"""Derivatives of zero: which of them weigh, on functions and models of which it is known."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.measured.agreement import sweep
from tog_mjx.checks.measured.zeros import cancelled, zeros
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.unused import unused
from tog_mjx.problems.scene_function import SceneFunction

NAMES = ("a", "b", "c")


def judged(function: Callable, slopes: list, **known) -> Finding:
    """Of a function of points [N, n] at zero."""
    n = len(slopes[0])
    differences = sweep(lambda points: np.stack(function(*points.T), axis=1), np.zeros(n), np.eye(n))
    outputs = [f"y{i}" for i in range(len(slopes))]
    return zeros(np.array(slopes, float), differences, NAMES[:n], outputs, **known)


def flat(x: np.ndarray) -> np.ndarray:
    """Of slope 1 on the whole, and 0 where |x| < 5e-2."""
    return np.round(10 * x) / 10


NOT_READ = {"kin": np.zeros(3, int), "unused": np.array([True, False, False])}
ALIKE = {"kin": np.zeros(3, int)}


def test_of_what_stays_the_same_it_says_how_far_it_has_looked():
    """Beyond the longest step it may move, as a ball that an arm reaches only then."""
    found = judged(lambda a: [np.maximum(a - 0.2, 0)], [[0]])
    assert found.sentence.endswith("(a): the output does not change over steps of up to 10% of a variable's size")
    assert found.remedy.startswith("begin elsewhere")


@pytest.mark.parametrize(
    ("function", "slopes", "known", "level", "words"),
    [
        (lambda a, b, c: [0 * a + b + c], [[0, 1, 1]], NOT_READ, Level.FINE, "rightly zero: a (nothing reads it)"),
        (
            lambda a, b, c: [0 * (a + b) + c],
            [[0, 0, 1]],
            NOT_READ,
            Level.FINE,
            "a (nothing reads it); b (no effect here)",
        ),
        (lambda a, b, c: [0 * (a + b + c)], [[0, 0, 0]], NOT_READ, Level.CARE, "3 of 3 derivatives are zero (a, b, c)"),
        (
            lambda a, b, c: [0 * (a + b) + c],
            [[0, 0, 1]],
            ALIKE,
            Level.FINE,
            "2 of 3 derivatives are rightly zero: a, b (no",
        ),
        (
            lambda a, b, c: [0 * a + flat(b) + c],
            [[0, 0, 1]],
            ALIKE,
            Level.CARE,
            "1 of 3 derivatives are zero (b): the output",
        ),
        (
            lambda a, b, c: [0 * (a + b) + c],
            [[0, 0, 1]],
            {},
            Level.CARE,
            "2 of 3 derivatives are zero (a, b): the output",
        ),
        (lambda a, b: [np.cos(a) + b], [[0, 1]], {}, Level.FINE, "1 of 2 derivatives are rightly zero: a (stationary"),
        (lambda a: [np.cos(a)], [[0]], {}, Level.FINE, "1 of 1 derivatives are rightly zero: a (stationary here)"),
        (lambda a, b: [a**2, b**3], [[0, 0], [0, 0]], {}, Level.FINE, "2 of 2 derivatives are rightly zero: a, b"),
        (lambda a, b: [a, 0 * b + 1, b**2], [[1, 0], [0, 0], [0, 0]], {}, Level.CARE, "no variable moves y1 (1 of 3"),
        (lambda a: [flat(a)], [[0]], {}, Level.CARE, "moves with longer steps only"),
        (lambda a: [np.round(1e3 * a) / 1e3], [[0]], {}, Level.CARE, "moves with longer steps only"),
        (lambda a, b: [a**2 + b], [[0, 0]], {}, Level.FAULT, "b: autodiff says zero, but differences do not"),
    ],
)
def test_only_what_should_matter_and_does_not_weighs(function, slopes, known, level, words):
    found = judged(function, slopes, **known)
    assert (found.level, words in found.sentence) == (level, True), found.sentence
    assert bool(found.remedy) == (level > Level.FINE)


SCENE = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" friction="1 .02 .001"/>
    <body name="post"><geom size=".1" mass="3" contype="0" conaffinity="0"/></body>
    <body name="ball" pos="0 0 .1"><joint type="slide" axis="0 0 1"/><joint type="slide"/>
      <geom name="ball" size=".1" mass="1" condim="{condim}" priority="{priority}" friction=".3 .02 .002"/></body>
    <body name="other" pos="1 0 .1"><freejoint/><geom name="other" size=".1" mass="1"/></body>
  </worldbody>
  <contact><pair geom1="floor" geom2="other" condim="4"/><exclude body1="ball" body2="other"/></contact>
</mujoco>"""
FLOOR, POST, BALL, OTHER = range(4)


@pytest.mark.parametrize(("condim", "read"), [(1, 0), (3, 1), (4, 2), (6, 3)])
@pytest.mark.parametrize("priority", [0, 1])
def test_numbers_that_nothing_reads(condim, priority, read):
    """The floor has condim 3: of equal priorities the larger one counts."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(condim=condim, priority=priority))
    expected = np.ones((4, 3), bool)
    expected[BALL, : read if priority else max(read, 1)] = False
    expected[FLOOR, : 0 if priority else max(read, 1)] = False
    np.testing.assert_array_equal(unused(model, "geom_friction"), expected)
    np.testing.assert_array_equal(unused(model, "geom_solref")[:, 0], [bool(priority), True, False, True])
    np.testing.assert_array_equal(unused(model, "geom_margin"), [False, True, False, True])
    np.testing.assert_array_equal(unused(model, "pair_friction"), [[False, False, False, True, True]])
    np.testing.assert_array_equal(unused(model, "body_mass"), [True, True, False, False])
    assert not unused(model, "dof_damping").any()


def test_what_changes_a_contact_by_mujoco_is_read():
    """Acceleration of the ball, sliding, spinning and rolling on the floor, with each number changed."""
    for condim in (1, 3, 4, 6):
        model = mujoco.MjModel.from_xml_string(SCENE.format(condim=condim, priority=1))
        assert (~unused(model, "geom_friction")).sum() == {1: 0, 3: 1, 4: 2, 6: 3}[condim]
        for geom, column in np.argwhere(unused(model, "geom_friction")).tolist():
            plain, changed = (_accelerations(model, geom, column, factor) for factor in (1.0, 3.0))
            np.testing.assert_array_equal(plain, changed)


def _accelerations(model: mujoco.MjModel, geom: int, column: int, factor: float) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[:] = -0.001, [0.0, 1.0, 0.1, 0.2, -0.1, 2.0, 3.0, 4.0]
    before = model.geom_friction[geom, column]
    model.geom_friction[geom, column] = factor * before
    mujoco.mj_forward(model, data)
    model.geom_friction[geom, column] = before
    assert data.ncon
    return data.qacc.copy()


def test_a_scene_knows_which_of_its_variables_are_alike():
    model = mujoco.MjModel.from_xml_string(SCENE.format(condim=3, priority=0))
    for wrt, kin, read in (
        ("qvel", [0, 0] + [1] * 6, [True] * 8),
        ("qpos[4]", [1], [True]),
        ("body_mass", [0] * 4, [False, False, True, True]),
        ("geom_friction[2, 1]", [0], [False]),
        ("geom_friction[2, 0]", [0], [True]),
        ("opt.gravity", [0] * 3, [True] * 3),
    ):
        scene = SceneFunction(model, mujoco.MjData(model), 1, wrt)
        assert (scene.x.kin.tolist(), (~scene.x.unused).tolist()) == (kin, read)


@pytest.mark.parametrize(("value", "level"), [(2.0, Level.FINE), (None, Level.CARE)])
def test_a_range_without_a_limit_is_no_care_beside_one_that_has_it(value, level):
    """Alone it is, and zeros say so; beside others nobody asks for its derivative."""
    xml = """<mujoco><worldbody><body><joint type="slide" range="0 1"/><joint type="slide" axis="0 1 0"/>
      <geom size=".1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    assert unused(model, "jnt_range").tolist() == [[False, False], [True, True]]
    (remark,) = [some for some in preflight(model, wrt="jnt_range") if "of no constraint" in some.what]
    assert remark.finding().level == Level.CARE
    assert remark.finding([Finding("zeros", Level.FINE if value else Level.CARE, "", value)]).level == level


@pytest.mark.parametrize(("condim", "told"), [(3, False), (4, True)])
def test_equal_frictions_are_a_kink_where_they_are_read(condim, told):
    """Those of spinning are equal, of sliding and rolling are not."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(condim=condim, priority=0))
    remarks = preflight(model, wrt="geom_friction")
    assert any("a contact takes the larger: a kink" in remark.what for remark in remarks) == told


@pytest.mark.parametrize(
    ("slope", "function", "told"),
    [
        (1e-11, lambda a: [0.5 + 1e-9 * np.sign(a)], True),  # As a solver's tolerance makes of a constant.
        (1e-11, lambda a: [0.5 + 1e-3 * a**2], True),
        (1e-11, lambda a: [0.5 + 1e-4 * a], False),  # Then autodiff has lost something.
        (1e-7, lambda a: [0.5 + 1e-7 * a], False),
        (0.0, lambda a: [0.5 + 0 * a], False),
    ],
)
def test_what_is_zero_but_for_rounding(slope, function, told):
    differences = sweep(lambda points: np.stack(function(*points.T), axis=1), np.zeros(1), np.eye(1))
    found = cancelled(np.array([[slope]]), differences, np.array([0.5]), ("body_mass[1]",))
    assert (found is not None) == told
    if found:
        assert (found.level, found.value) == (Level.FINE, slope)
        assert "what follows from body_mass[1] undoes what it does" in found.sentence
