"""The checks that run a motion otherwise: their judgements of sequences, and what they change in the model."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from tog_mjx.checks.measured.recorded import Motion, Simulation
from tog_mjx.checks.measured.variants import judge_solver, judge_stiffness, judge_time_step, stiffer, time_step
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.keyframes import keyframe_start
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.stepping._mjx import put_model

GALLERY = Path(__file__).parent / "scenes" / "verdicts"


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ((0.04, 0.02), Level.FINE, "changes by 4.0% from dt to dt/2, 2.0% to dt/4"),
        ((1e-9, 3e-9), Level.FINE, "0.0% to dt/4"),
        ((0.25, 0.03, 0.02), Level.CARE, "2.0% to dt/8; it settles at dt/2, 0.005 s"),
        ((0.2, 0.11, 0.05, 0.02), Level.CARE, "settles at dt/4, 0.0025 s"),
        ((0.3, 0.2, 0.05, 0.02), Level.FAULT, "not of the physics"),  # 0.9 in all, as a geometric series.
        ((0.6, 0.05, 0.02), Level.FAULT, "settles at dt/2, 0.005 s"),
        ((1.4, 0.09, 0.25, 0.2), Level.FAULT, "does not settle"),  # The second is small by chance.
        ((0.02, 0.3, 0.1, 0.05), Level.FAULT, "settles at dt/4, 0.0025 s"),
        ((0.2, 0.12, 0.11, 0.11), Level.FAULT, "does not settle"),
        ((0.94, 0.93, 0.34, 0.04), Level.FAULT, "may settle at dt/8, 0.00125 s"),
        ((0.2, 0.12, 0.11, 0.1), Level.FAULT, "may settle at dt/8, 0.00125 s"),
        ((0.02, np.nan), Level.FAULT, "dt/4 the gradient is not finite"),
    ],
)
def test_a_gradient_of_the_time_step_is_not_trusted(changes, level, words):
    found = judge_time_step(changes, 0.01, 100)
    assert (found.level, words in found.sentence) == (level, True), found.sentence
    assert bool(found.remedy) == (level > Level.FINE)
    if "settles at dt/4" in found.sentence:
        assert found.remedy.startswith("set <option timestep='0.0025'> and take 400 steps")


class Pushed(Simulation):
    """A mass of 1 kg under a force u, by semi-implicit Euler: d x / d u after n steps is n (n + 1) dt^2 / 2."""

    def __init__(self, steps: int):
        model = mujoco.MjModel.from_xml_string("<mujoco><option timestep='0.01'/></mujoco>")
        self.scene: Any = SimpleNamespace(steps=steps, model=model)
        self.model = put_model(model)
        self.runs: list[tuple[int, float]] = []

    def run(self, model: Any = None, steps: int | None = None, start: Any = None) -> Motion:  # noqa: ARG002
        n, dt = steps or self.scene.steps, float((model or self.model).opt.timestep)
        self.runs.append((n, dt))
        nothing: dict[str, Any] = dict.fromkeys(Motion._fields)
        return Motion(**nothing)._replace(slopes=np.array([[n * (n + 1) * dt**2 / 2]]))


@pytest.mark.parametrize(("steps", "level"), [(1, Level.FINE), (2, Level.CARE), (5, Level.FINE), (100, Level.FINE)])
def test_one_step_has_nothing_to_refine_and_more_keep_their_horizon(steps, level):
    """By semi-implicit Euler the derivative is (1 + 1 / n) of its limit: the change is 1 / (2 n + 2)."""
    pushed = Pushed(steps)
    found = time_step(pushed, pushed.run())
    assert found.level == level, found.sentence
    np.testing.assert_allclose([n * dt for n, dt in pushed.runs], steps * 0.01, rtol=1e-12)
    if steps > 1:
        assert found.value == pytest.approx(1 / (2 * steps + 2))
        assert len(pushed.runs) >= 3
    else:
        assert (len(pushed.runs), found.value) == (1, None)
        assert found.sentence == "not halved: the motion is one time step, with nothing to refine"


CUBE = """<mujoco>
  <option timestep="0.002" iterations="100" ls_iterations="50" tolerance="1e-12"/>
  <default><geom friction="0.5" solref="0.004 0.5"/><joint type="slide"/></default>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body pos="0 0 0.5"><joint axis="1 0 0"/><joint axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
      <site name="middle"/><geom type="box" size="0.1 0.1 0.1" mass="1" contype="0" conaffinity="0"/>
      <geom size="0.01" pos="-0.1 0 -0.1" mass="0"/><geom size="0.01" pos="0.1 0 -0.1" mass="0"/>
      <geom size="0.01" pos="-0.1 0 0.1" mass="0"/><geom size="0.01" pos="0.1 0 0.1" mass="0"/></body>
  </worldbody>
  <keyframe><key qpos="0 -0.24 0.17" qvel="0.8 -1.5 4.4"/></keyframe>
</mujoco>"""


def judged(model: mujoco.MjModel, start: mujoco.MjData, steps: int, wrt: str, site: str) -> Finding:
    scene = SceneFunction(model, start, steps, wrt, site)
    simulation = Simulation(scene, np.eye(len(scene.x.names)), states=False)
    return time_step(simulation, simulation.run())


def test_a_tossed_hard_cube_is_not_trusted():
    """It tumbles on its corners. Halving the time step changes the gradient by 12 %, and halving it again by all."""
    model = mujoco.MjModel.from_xml_string(CUBE)
    found = judged(model, keyframe_start(model), 120, "qvel", "middle")
    assert (found.level, "does not settle" in found.sentence) == (Level.FAULT, True), found.sentence
    assert found.value == pytest.approx(0.119, abs=0.002)
    assert len(found.curves["gradient norm"]) == 5


def test_a_long_double_pendulum_is_not_trusted():
    """Six seconds of Euler's method, 3,000 steps: 46 % from dt to dt/2, 35 % to dt/4, and no end in sight."""
    model = compile_model(GALLERY / "chaotic_pendulum.xml")
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_EULER, 0.002
    start = mujoco.MjData(model)
    start.qpos[:] = 1.0, 0.5
    found = judged(model, start, 3000, "qpos", "watched")
    assert found.level == Level.FAULT
    assert "changes by 46.2% from dt to dt/2, 35.4% to dt/4, and does not settle" in found.sentence


TWO_BALLS = """<mujoco>
  <option timestep="0.002" iterations="200" ls_iterations="100" tolerance="1e-14" cone="elliptic" gravity="0 0 -10"/>
  <default><geom solref="{geom}" friction="0.4"/><joint type="slide"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body pos="0 0 .0995"><joint axis="1 0 0"/><joint axis="0 0 1"/><geom size=".1" mass="1"/></body>
    <body pos="0 1 .0995"><joint axis="1 0 0"/><joint axis="0 0 1"/><geom name="ball" size=".1" mass="1"/></body>
  </worldbody>
  <contact><pair geom1="floor" geom2="ball" condim="3" friction="0.4 0.4 0 0 0" solref="-4000 -40"
    solreffriction="{friction}"/></contact>
</mujoco>"""
"""They slide on a plane: one by the law of its geoms, the other by that of a pair."""


def slid(geom: str, friction: str, factor: float) -> np.ndarray:
    """Positions after 0, 10, ..., 100 steps, with contacts so many times as stiff and all else as much faster."""
    model = mujoco.MjModel.from_xml_string(TWO_BALLS.format(geom=geom, friction=friction))
    for name, changed in stiffer(model, factor).items():
        getattr(model, name)[:] = changed
    model.opt.timestep /= factor**0.5
    model.opt.gravity *= factor
    data = mujoco.MjData(model)
    data.qvel[:] = factor**0.5 * np.array([0.3, 0, 0.3, 0])
    found = []
    for _ in range(11):
        found.append(data.qpos.copy())
        mujoco.mj_step(model, data, 10)
    return np.array(found)


@pytest.mark.parametrize("geom", ["0.02 0.7", "-4000 -40"])
@pytest.mark.parametrize("friction", ["0 0", "0 -30", "0.03 1"])
def test_four_times_the_stiffness_is_the_same_motion_twice_as_fast(geom, friction):
    """With speeds twice and gravity four times as large, at half the time step: positions are the same, so that all
    of a contact's law has been scaled, and nothing twice."""
    plain, stiff = (slid(geom, friction, factor) for factor in (1.0, 4.0))
    np.testing.assert_allclose(stiff, plain, rtol=0, atol=1e-9)
    assert (np.ptp(plain, axis=0)[[0, 2]] > 1e-2).all()


@pytest.mark.parametrize(
    ("soft", "hard", "level"),
    [
        ([0.25, 0.0], [4.0, 0.0], Level.FINE),  # Proportional to the stiffness.
        ([1.0, 1.0], [1.0, -1.0], Level.FINE),
        ([-0.1, 1.0], [1.0, 0.0], Level.CARE),
        ([1.0, 0.0], [0.0, 0.0], Level.CARE),  # Nothing is touched any more.
        ([1.0, 0.0], [30.0, 0.0], Level.CARE),
        ([1.0, 0.0], [np.nan, 0.0], Level.CARE),
    ],
)
def test_what_hangs_on_the_stiffness_is_told(soft, hard, level):
    assert judge_stiffness(*(np.array([some]) for some in ([1.0, 0.0], soft, hard))).level == level


@pytest.mark.parametrize(
    ("correction", "change", "moved", "level"),
    [
        (5e-4, 5e-4, 5e-4, Level.FINE),
        (5e-4, 5e-4, 5e-3, Level.CARE),  # Small corrections add up to another motion.
        (5e-4, 5e-4, 0.2, Level.FAULT),
        (5e-4, 0.01, 0.0, Level.CARE),
        (0.1, 0.0, 0.0, Level.FAULT),
        (np.nan, 0.0, 0.0, Level.FAULT),
        (5e-4, np.nan, 0.0, Level.FAULT),
    ],
)
def test_an_unconverged_solver_is_judged_by_the_worst_it_does(correction, change, moved, level):
    assert judge_solver(correction, change, moved, (4, 8), 50).level == level
