"""What a viewer is given to show: motions, their pace, the view, and the files."""

import jax
import mujoco
import numpy as np
import pytest
from conftest import simulate_in_c
from PIL import Image, ImageSequence
from saved_run import COSTS, save_run

from tog_mjx.drawing.viewing import Live, Loop, Motion, frame_times, render, simulate, start, write_gif
from tog_mjx.drawing.viewing.camera import aim, window
from tog_mjx.drawing.viewing.child import run_python
from tog_mjx.drawing.viewing.looks import dress
from tog_mjx.drawing.viewing.playback import HOLD
from tog_mjx.engines.objective import rollout
from tog_mjx.mjcf.scene import compile_model, load_scene, scene_path
from tog_mjx.paper import comparison
from tog_mjx.paper.replay import read_iterate, replay
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.errors import InputError

U = np.array([0.1, 1.0])


def model_of(task: str = "flip") -> mujoco.MjModel:
    return compile_model(scene_path(task))


def saved_run(folder, simulator="penalty", task="flip"):
    setpoints = get_task(task).initial_guess + np.array([[0.0], [0.1], [0.05]])
    return save_run(folder, setpoints, simulator, task), setpoints


KEYS = '<keyframe><key name="a" ctrl="3"/>{}</keyframe>'


@pytest.mark.parametrize(
    ("keyframes", "control"),
    [("", 0), (KEYS.format(""), 3), (KEYS.format('<key name="start" ctrl="4" qpos="0.5"/>'), 4)],
)
def test_a_scene_starts_at_its_keyframe(keyframes, control):
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="j" type="slide"/><geom size="0.1"/></body></worldbody>
        <actuator><position joint="j"/></actuator>{keyframes}</mujoco>"""
    )
    data = start(model)
    assert data.ctrl == [control]
    assert data.qpos == [0.5 if control == 4 else 0]
    assert start(model, np.array([7.0])).ctrl == [7]


@pytest.mark.parametrize("task", ["flip", "grasp"])
def test_markers_and_the_keyframe_follow_the_setpoints(task):
    model = model_of(task)
    setpoints = np.linspace(0.3, 0.6, model.nu)
    before = model.site_pos[:, 1].copy()
    data = start(model, setpoints)
    sites = [model.site(f"setpoint{i + 1}").id for i in range(model.nu // 2)]
    np.testing.assert_array_equal(data.site_xpos[sites][:, [0, 2]].ravel(), setpoints)
    np.testing.assert_array_equal(model.site_pos[:, 1], before)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    np.testing.assert_array_equal(data.ctrl, setpoints)


def test_a_marker_at_the_origin_moves_too():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><site name="setpoint1"/>
        <body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide"/><geom size="0.1"/></body>
        </worldbody><actuator><position joint="x"/><position joint="z"/></actuator></mujoco>"""
    )
    np.testing.assert_array_equal(start(model, np.array([2.0, 3.0])).site_xpos, [[2, 0, 3]])


def test_the_simulation_is_that_of_c_mujoco():
    task, model = get_task("flip"), model_of()
    motion = simulate(model, start(model, U), 0.599)
    np.testing.assert_array_equal(motion.qpos[:, task.scene.joints], simulate_in_c(task, U)[0])
    np.testing.assert_allclose(motion.time, np.arange(600) * 0.001, atol=1e-12)


def test_a_simulation_that_diverges_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="the simulation diverges after"):
        simulate(model := model_of(), start(model, np.array([1e9, 1.0])), 0.1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("which", "number"), [("best", 1), ("last", 2), (0, 0)])
def test_an_iterate_is_read_from_its_run(tmp_path, which, number):
    path, setpoints = saved_run(tmp_path)
    iterate = read_iterate(path, which)
    assert (iterate.task.name, iterate.simulator, iterate.number) == ("flip", "penalty", number)
    assert iterate.cost == COSTS[number]
    np.testing.assert_array_equal(iterate.setpoints, setpoints[number])


@pytest.mark.parametrize(("simulator", "is_double"), [("penalty", True), ("released", False)])
def test_a_replay_is_the_motion_of_its_simulator_in_its_precision(tmp_path, simulator, is_double):
    path, setpoints = saved_run(tmp_path, simulator, "grasp")
    with jax.enable_x64(is_double):
        expected = rollout("grasp", setpoints[1], simulator)
        positions = np.concatenate([expected.box[:, :3], expected.fingers[:, :, :2].reshape(500, -1)], axis=1)
    motion = replay(read_iterate(path))
    np.testing.assert_array_equal(motion.qpos[:, get_task("grasp").scene.joints], positions)
    assert motion.time[-1] == pytest.approx(0.499)
    longer = replay(read_iterate(path), 0.6)
    assert len(longer.time) == 601
    np.testing.assert_allclose(longer.qpos[:500], motion.qpos, atol=1e-12 if is_double else 1e-4)


def test_a_result_of_another_scene_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(comparison, "scene_digest", lambda _: "older")
    path, _ = saved_run(tmp_path)
    with pytest.raises(InputError, match="another version of the scene flip"):
        read_iterate(path)


def test_a_loop_keeps_pace_and_holds_its_end():
    model = model_of()
    data = mujoco.MjData(model)
    motion = Motion(np.array([0.0, 0.1, 0.2]), np.arange(15.0).reshape(3, 5))
    loop = Loop(model, data, motion, speed=0.5)
    np.testing.assert_array_equal(data.qpos, motion.qpos[0])
    shown = []
    for seconds in (0.0, 0.1, 0.11, 0.25, HOLD - 0.1, 0.1):
        loop.advance(seconds)
        shown.append(int(data.qpos[0]) // 5)
    assert shown == [0, 0, 1, 2, 2, 0]
    np.testing.assert_array_equal(motion.at(np.array([0.05, 0.1, 9.0])).qpos, motion.qpos[[0, 1, 2]])


def test_a_live_simulation_waits_then_keeps_pace_and_does_not_rush():
    model = model_of()
    data = start(model)
    live = Live(model, data)
    for _ in range(10):
        live.advance(HOLD / 10)
    assert data.time == 0
    for _ in range(5):
        live.advance(0.0105)
    np.testing.assert_allclose(data.time, 0.0525, atol=0.0011)
    live.advance(1000.0)
    np.testing.assert_allclose(data.time, 0.1525, atol=0.0011)
    data.ctrl[:] = 0.7, 0.8
    live.advance(0.01)
    np.testing.assert_array_equal(model.site("setpoint1").pos[[0, 2]], [0.7, 0.8])


def test_frames_are_spread_over_the_motion():
    times = frame_times(0.599, fps=10.0, speed=0.25)
    assert len(times) == 25
    assert (times[0], times[-1]) == (0, 0.599)
    np.testing.assert_allclose(np.diff(times[:-1]), 0.025)
    np.testing.assert_array_equal(frame_times(1.0, 2.0, 1.0), [0, 0.5, 1])


def test_the_view_widens_only_where_the_motion_leaves_it():
    model = model_of()
    before = window(model)
    motion = simulate(model, start(model), 0.599)
    aim(model, mujoco.MjData(model), motion.qpos, 16 / 9)
    np.testing.assert_allclose(window(model), before)
    motion = simulate(model, start(model, np.array([0.5, 16.0])), 0.599)
    aim(model, mujoco.MjData(model), motion.qpos, 16 / 9)
    x, z, height = window(model)
    finger = motion.qpos[:, get_task("flip").scene.joints[3:]]
    assert finger[:, 1].max() > before.z + before.height / 2
    assert (np.abs(finger - [x, z]) < 0.5 * height * np.array([16 / 9, 1])).all()
    assert np.abs(np.array([0.5, 16.0]) - [x, z])[1] > 0.5 * height  # The setpoint, far away, is left out.


CUBE = """<mujoco><worldbody><geom type="plane" size="9 9 1"/>
  <body pos="0.3 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
  <body pos="0 0 0.1"><joint type="slide" axis="1 0 0"/><geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("backend", ["egl", "osmesa", "disable"])
def test_what_moves_is_seen_in_a_scene_without_light_colour_or_camera(backend, monkeypatch):
    """A sphere drives up to a cube on a plane, and both go on."""
    monkeypatch.setenv("MUJOCO_GL", backend)
    model = mujoco.MjModel.from_xml_string(CUBE)
    qpos = np.array([[0.3, 0, 0.1, 1, 0, 0, 0, 0.0], [0.3, 0, 0.1, 1, 0, 0, 0, 0.1], [0.7, 0, 0.1, 1, 0, 0, 0, 0.5]])
    images, method = render(model, mujoco.MjData(model), Motion(np.arange(3.0), qpos), (160, 90))
    if backend != "disable" and "without OpenGL" in method:
        pytest.skip(f"no OpenGL here: {method}")
    images = images.astype(int)
    moving = np.ptp(images, axis=3) > 30  # The plane and its shadows are grey.
    assert (moving.mean(axis=(1, 2)) > 0.03).all()
    assert not moving[:, [0, -1]].any()
    assert not moving[:, :, [0, -1]].any()
    assert all(image[seen].max(axis=1).mean() > 120 for image, seen in zip(images, moving, strict=True))
    assert np.median(images) > 90
    ends = [np.flatnonzero(seen.any(axis=0))[[0, -1]] for seen in moving]
    (left, right), (closer, still), (_, after) = ends
    assert left + 5 < closer
    assert abs(right - still) <= 1
    assert still + 25 < after


def dark(model: mujoco.MjModel) -> bool:
    return dress(model, mujoco.MjData(model), 1.0).is_dark


def test_the_light_and_the_colours_of_a_file_are_kept():
    for task in ("flip", "grasp"):
        model = model_of(task)
        before = model.geom_rgba.copy(), model.vis.headlight.ambient.copy(), model.vis.headlight.diffuse.copy()
        sites = model.site_rgba.copy(), model.site_size.copy()
        assert not dark(model)
        np.testing.assert_array_equal(model.geom_rgba, before[0])
        np.testing.assert_array_equal([model.vis.headlight.ambient, model.vis.headlight.diffuse], before[1:])
        for kept, found in zip(sites, (model.site_rgba, model.site_size), strict=True):
            np.testing.assert_array_equal(found, kept)
    lit = mujoco.MjModel.from_xml_string(CUBE.replace("<worldbody>", "<worldbody><light pos='0 0 3'/>", 1))
    assert not dark(lit)
    mine = CUBE.replace("<worldbody>", "<visual><headlight diffuse='1 0 0'/></visual><worldbody>", 1)
    assert not dark(mujoco.MjModel.from_xml_string(mine))
    assert dark(mujoco.MjModel.from_xml_string(CUBE))


def test_the_times_of_a_gif_do_not_drift(tmp_path):
    images = np.zeros((31, 16, 16, 3), np.uint8)
    images[np.arange(31), np.arange(31) // 16 * 4, np.arange(31) % 16] = 255
    write_gif(tmp_path / "a.gif", images, fps=30.0)
    with Image.open(tmp_path / "a.gif") as gif:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
    assert len(durations) == 31
    assert sum(durations) == pytest.approx(1000 * (31 / 30 + HOLD), abs=10)


def test_what_ends_a_child_is_told():
    assert run_python("-c", "pass") is None
    assert run_python("-c", "raise ValueError('no')") == "ValueError: no"
    assert run_python("-c", "import os; os.abort()") == "ended by signal 6"


def test_a_scene_that_mjx_rejects_compiles(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text('<mujoco><option noslip_iterations="3"/></mujoco>')
    assert compile_model(path).opt.noslip_iterations == 3
    with pytest.raises(InputError, match="noslip"):
        load_scene(path)
