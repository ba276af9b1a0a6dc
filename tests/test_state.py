"""What a step passes on and what it is given, and the one place where a scene starts."""

import dataclasses

import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.measured import parity as parity_of
from tog_mjx.checks.measured.parity import parity
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.checks.step_check import step_function
from tog_mjx.checks.told.finding import Level
from tog_mjx.drawing.viewing import start as shown_start
from tog_mjx.engines import reference
from tog_mjx.mjcf.keyframes import keyframe_start, saved_start
from tog_mjx.mjcf.scene import load_scene, scene_path
from tog_mjx.paper.tasks import get_task
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.stepping import mjx_state as state
from tog_mjx.stepping._mjx import put_model

FILTERED = """<mujoco><option timestep="0.01"/><worldbody><body name="held" mocap="true"/>
  <body><joint name="hinge" axis="0 1 0" damping="0.1"/><geom size="0.1" pos="0 0 0.5" mass="1"/></body></worldbody>
  <equality><weld body1="held" body2="world" active="false"/></equality>
  <actuator><general joint="hinge" dyntype="integrator" gainprm="3"/></actuator>
  <keyframe>{}<key name="start" time="2" qpos="0.2" qvel="1" act="0.5" ctrl="2" mpos="1 2 3"/></keyframe></mujoco>"""
"""A motor whose force grows by its control, behind one other keyframe or none."""


def model_of(other: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(FILTERED.format(other))


def test_all_of_a_state_and_its_inputs_is_copied():
    """A step from the copy is the step from the original, to the bit, in C MuJoCo and on MJX."""
    model = model_of()
    data = state.default_start(model)
    data.qfrc_applied[:], data.xfrc_applied[2], data.eq_active[:] = 0.3, [0, 0, 5, 0, 1, 0], 1
    mujoco.mj_step(model, data)  # So that there is a warm start.
    copy, on_mjx = state.copy_of(model, data, time=7.0), state.on_mjx(put_model(model), data)
    assert copy.time == 7
    for name in (*state.STATE[1:], *state.INPUTS):
        expected = np.asarray(getattr(data, name))
        assert expected.any(), f"{name} is not tested"
        np.testing.assert_array_equal(getattr(copy, name), expected)
        np.testing.assert_array_equal(getattr(on_mjx, name), expected)
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, copy)
    np.testing.assert_array_equal([*copy.qpos, *copy.qvel, *copy.act], [*data.qpos, *data.qvel, *data.act])


def test_parity_steps_from_the_states_of_the_motion(monkeypatch):
    """The motor's activation grows by 2 * 0.01 a step from 0.5, and so does that from which C MuJoCo steps."""
    model, seen = model_of(), []
    scene = SceneFunction(model, state.default_start(model), 30)
    simulation = Simulation(scene, np.eye(1))
    motion = simulation.run()
    step = mujoco.mj_step

    def watched(model, data, nstep=1):
        seen.append((data.time, *data.qpos, *data.qvel, *data.act))
        step(model, data, nstep)

    monkeypatch.setattr(parity_of.mujoco, "mj_step", watched)
    found = parity(simulation, motion)
    *steps, whole = seen
    assert found.level == Level.FINE
    assert found.value is not None
    assert found.value < 1e-10
    assert whole == (2, 0.2, 1, 0.5)
    expected = state.default_start(model)
    for i, start in enumerate(steps):
        np.testing.assert_allclose(start, (2 + 0.01 * i, *expected.qpos, *expected.qvel, 0.5 + 0.02 * i), atol=1e-12)
        step(model, expected)
    assert len(steps) == 30


OTHER = '<key name="other" qpos="0.1" ctrl="1"/>'


@pytest.mark.parametrize(
    ("keyframes", "position"),
    [
        ("", 0.0),
        (f"<keyframe>{OTHER}</keyframe>", 0.1),
        (f'<keyframe>{OTHER}<key name="start" qpos="0.2"/></keyframe>', 0.2),
    ],
)
def test_every_road_starts_at_the_same_place(keyframes, position, tmp_path, monkeypatch):
    """At the keyframe `start`, else at the first one, else at the initial pose."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="j" type="slide"/><geom size="0.1"/></body></worldbody>
        <actuator><position joint="j"/></actuator>{keyframes}</mujoco>"""
    )
    (tmp_path / "state.json").write_text('{"ctrl": [4]}')
    starts = [state.default_start(model), keyframe_start(model), saved_start(model, tmp_path / "state.json")]
    starts.append(shown_start(model))
    assert [data.qpos[0] for data in starts] == [position] * 4
    function = step_function(model)
    assert function.x[function.names.index("qpos[0]")] == position
    met: list[float] = []

    def spoilers(question, _engine):
        met.append(question.data.qpos[0])
        return []

    def no_further(scene, directions):  # noqa: ARG001
        met.append(scene.start.qpos[0])
        raise KeyboardInterrupt

    monkeypatch.setattr("tog_mjx.checks.file.preflight._spoilers", spoilers)
    preflight(model)
    monkeypatch.setattr("tog_mjx.checks.scene_verdict.Simulation", no_further)
    with pytest.raises(KeyboardInterrupt):
        tog.check_scene(model)
    assert met == [position] * 4  # C MuJoCo's answer has a preflight of its own.


def test_a_task_starts_where_its_scene_does(tmp_path):
    """Also where that is a keyframe in motion; the reference in C MuJoCo from the same place."""
    spec = mujoco.MjSpec.from_file(str(scene_path("flip")))
    spec.key("start").qpos, spec.key("start").qvel = [0.1, 0.3, 0.2, -0.6, 0.3], [0.1, 0.2, 0.3, 0.4, 0.5]
    (tmp_path / "moving.xml").write_text(spec.to_xml())
    scene = load_scene(tmp_path / "moving.xml")
    box, fingers = scene.start
    np.testing.assert_array_equal(box, [0.1, 0.3, 0.2, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(fingers, [[-0.6, 0.3, 0.4, 0.5]])
    np.testing.assert_array_equal(scene.initial_guess, [0, 0.25])
    task = dataclasses.replace(get_task("flip"), model=tmp_path / "moving.xml", steps=1)
    data = state.default_start(scene.model)
    mujoco.mj_step(scene.model, data)
    (cost,) = reference.final_costs(task, task.initial_guess[None], threads=1)
    np.testing.assert_allclose(cost, data.qpos[0] ** 2 + data.qpos[2] ** 2, rtol=1e-12)
