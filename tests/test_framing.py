"""What moves fills the picture and stays in it, from a side that shows it, under a light; targets are seen."""

import mujoco
import numpy as np
import pytest

from tog_mjx.drawing.viewing import Loop, Motion, frame_times, render, simulate, start
from tog_mjx.drawing.viewing.camera import aim, direction
from tog_mjx.drawing.viewing.looks import dress
from tog_mjx.drawing.viewing.playback import Live

ASPECT = 16 / 9
FALLING = """<mujoco><worldbody><geom type="plane" size="3 3 0.1"/>
  <body pos="0 0 0.4" euler="20 30 10"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
  </worldbody></mujoco>"""
ROLLING = """<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="5 5 0.1"/>
  <body pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.1"/></body></worldbody>
  <keyframe><key name="start" qpos="0 0 0.1 1 0 0 0" qvel="1.5 0.3 0 0 15 0"/></keyframe></mujoco>"""
THROWN = """<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="9 9 0.1"/>
  <body pos="0 0 1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom size="0.03"/></body>
  </worldbody><keyframe><key name="start" qvel="4 3"/></keyframe></mujoco>"""
ARM = """<mujoco><worldbody><body name="base"><geom type="cylinder" size="0.1 0.1"/>
  <body pos="0 0 0.1"><joint axis="0 0 1" damping="0.2"/><joint axis="0 1 0" damping="0.2"/>
  <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.5"/><body pos="0 0 0.5"><joint axis="0 1 0" damping="0.1"/>
  <geom type="capsule" size="0.04" fromto="0 0 0 0 0 0.4"/></body></body></body></worldbody>
  <keyframe><key name="start" qpos="0.3 0.5 0.4" qvel="3 0 0"/></keyframe></mujoco>"""
APART = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body pos="-0.2 0 0"><freejoint/><geom size="0.1"/></body><body pos="0.2 0 0"><freejoint/><geom size="0.1"/></body>
  </worldbody><keyframe><key name="start" qpos="-0.2 0 0 1 0 0 0 0.2 0 0 1 0 0 0"
  qvel="-1 0 0 0 0 0 1.5 0 0 0 0 0"/></keyframe></mujoco>"""
SCENES = {"falling": FALLING, "rolling": ROLLING, "thrown": THROWN, "arm": ARM, "apart": APART}
FOLLOWED = ("falling", "rolling", "thrown", "apart")


def shown(xml: str, fps: float = 20.0) -> tuple[mujoco.MjModel, mujoco.MjData, Motion]:
    """A scene, and two seconds of its motion."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = start(model)
    return model, data, simulate(model, data, 2.0).at(frame_times(2.0, fps, 1.0))


def corners(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> np.ndarray:
    """Of the boxes around the geoms of bodies that have joints, or carry them."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in np.flatnonzero(model.geom_bodyid):
        centre, half = model.geom_aabb[geom].reshape(2, 3)
        for signs in np.ndindex(2, 2, 2):
            corner = centre + half * (2 * np.array(signs) - 1)
            found.append(data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ corner)
    return np.array(found)


def projected(model: mujoco.MjModel, data: mujoco.MjData, views, i: int, points: np.ndarray) -> np.ndarray:
    """Where MuJoCo's free camera shows the points, from -1 to 1 across the picture and up."""
    camera, scene = mujoco.MjvCamera(), mujoco.MjvScene(model, 100)
    camera.azimuth, camera.elevation = views.azimuth, views.elevation
    camera.lookat[:], camera.distance = views.lookat[i], views.distance
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mj_forward(model, data)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), camera, everything, scene)
    eye = scene.camera[0]
    forward, up = np.array(eye.forward), np.array(eye.up)
    away = points - np.array(eye.pos)
    half = eye.frustum_top / eye.frustum_near * (away @ forward)
    assert (half > 0).all()
    return np.stack([away @ np.cross(forward, up) / (half * ASPECT), away @ up / half], axis=1)


def from_the_side(views, i: int, points: np.ndarray) -> np.ndarray:
    x, z, height = views.windows[i]
    return (points[:, [0, 2]] - [x, z]) / (height / 2 * np.array([ASPECT, 1]))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("view", ["free camera", "side"])
def test_what_moves_fills_every_frame_and_leaves_none(name, view):
    model, data, motion = shown(SCENES[name])
    views = aim(model, data, motion.qpos, ASPECT)
    filled = []
    for i, qpos in enumerate(motion.qpos):
        points = corners(model, data, qpos)
        at = projected(model, data, views, i, points) if view == "free camera" else from_the_side(views, i, points)
        assert np.abs(at).max() < 0.9
        filled.append((np.ptp(at, axis=0) / 2).max())
    assert max(filled) <= 0.9
    assert min(filled) >= 0.3


def test_the_camera_stands_where_all_is_large_enough_from_one_place():
    model, data, motion = shown(ARM)
    tip = np.array([corners(model, data, qpos).max(axis=0) for qpos in motion.qpos])
    assert np.ptp(tip, axis=0).max() > 0.3
    assert np.ptp(aim(model, data, motion.qpos, ASPECT).lookat, axis=0).max() < 1e-9


def test_the_camera_follows_the_way_and_not_each_shake():
    """A ball that goes 1 m while it shakes up and down by 2 cm."""
    model = mujoco.MjModel.from_xml_string(THROWN)
    time = np.linspace(0, 2, 101)
    qpos = np.column_stack([0.5 * time, 0.01 * np.sin(20 * np.pi * time)])
    lookat = aim(model, mujoco.MjData(model), qpos, ASPECT).lookat
    assert np.abs(lookat[:, 0] - qpos[:, 0]).max() < 0.1
    assert np.ptp(lookat[:, 2]) < 0.5 * np.ptp(qpos[:, 1])
    assert np.abs(np.diff(lookat, n=2, axis=0)).max() < 0.2 * np.abs(np.diff(qpos, n=2, axis=0)).max()


JOINT = '<mujoco>{}<worldbody><body><joint {}/><joint {}/><geom size="0.1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("file", "one", "other", "angles"),
    [
        ("", 'type="slide" axis="1 0 0"', 'axis="0 1 0"', (90, -10)),
        ("", 'type="slide" axis="0 0 1"', 'type="slide" axis="0 0 -1"', (90, -10)),
        ("", 'type="slide" axis="0 0 1"', 'axis="-1 0 0"', (180, -10)),
        ("", 'type="slide" axis="1 0 0"', 'axis="0 0 1"', (90, -60)),
        ("", 'type="slide" axis="1 1 0"', 'axis="1 -1 0"', (135, -10)),
        ("", 'axis="1 0 0"', 'axis="0 1 0"', (120, -25)),
        ("", 'type="ball"', 'type="slide"', (120, -25)),
        ('<visual><global azimuth="10"/></visual>', 'type="slide" axis="1 0 0"', 'axis="0 1 0"', (10, -45)),
    ],
)
def test_a_plane_of_motion_is_seen_from_its_side_and_all_else_from_an_angle(file, one, other, angles):
    model = mujoco.MjModel.from_xml_string(JOINT.format(file, one, other))
    np.testing.assert_allclose(direction(model, mujoco.MjData(model)), angles, atol=1e-9)


AIMED = """<mujoco><worldbody><geom type="plane" size="0 0 0.1"/>{}
  <body pos="0 0 0.1"><joint type="slide" axis="1 0 0"/>
  <geom type="box" size="0.1 0.1 0.1" rgba="0.8 0.3 0.3 1"/></body></worldbody></mujoco>"""
BALL = '<body name="aim" mocap="true" pos="0.4 -0.3 0.2"/>'


@pytest.fixture(params=["egl", "osmesa", "disable"])
def draw(request, monkeypatch):
    """Renders still pictures of scenes, at given qpos; or skips for want of OpenGL."""
    monkeypatch.setenv("MUJOCO_GL", request.param)

    def images(xml: str, qpos, size=(320, 180)) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(xml)
        found, method = render(model, start(model), Motion(np.arange(float(len(qpos))), np.array(qpos)), size)
        if request.param != "disable" and "without OpenGL" in method:
            pytest.skip(f"no OpenGL here: {method}")
        return found.astype(int)

    return images


def green(images: np.ndarray) -> np.ndarray:
    return (images[..., 1] - images[..., 0] > 60) & (images[..., 1] - images[..., 2] > 10)


OWN = '<site name="goal" pos="0.4 -0.3 0.2" size="0.02" rgba="0 0.9 0 1"/>'


@pytest.mark.parametrize("aims", ['<site name="Goal" pos="0.4 -0.3 0.2"/>', BALL, OWN])
def test_a_target_is_seen(draw, aims):
    assert 10 < green(draw(AIMED.format(aims), [[0.0]])).sum() < 1000


def test_a_target_that_is_far_away_is_left_out(draw):
    assert not green(draw(AIMED.format('<site name="goal" pos="9 0 0.1"/>'), [[0.0]])).any()


def test_a_hidden_target_and_any_other_site_stay_as_they_are(draw):
    others = '<site name="wrist" pos="0.3 -0.3 0.2"/><site name="goal" pos="0.4 -0.3 0.2" group="4"/>'
    assert not green(draw(AIMED.format(others), [[0.0]])).any()


def test_a_picture_is_bright_with_shadows_and_a_floor_that_shows_the_way(draw):
    images = draw(ROLLING, [[x, 0, 0.1, 1, 0, 0, 0] for x in (0.0, 1.03, 2.1)])
    ball = np.ptp(images, axis=3) > 60
    assert (ball.mean(axis=(1, 2)) > 0.03).all()
    for image, inside in zip(images, ball, strict=True):
        assert 110 < image[inside].mean() < 200  # Neither dark nor washed out.
        assert image.max(axis=2).min() > 40  # Nothing is black.
        floor = image[-40:][~inside[-40:]].mean(axis=1)
        assert np.percentile(floor, 90) - np.percentile(floor, 10) > 12  # Tiles.
    moved = np.abs(images[1] - images[0]).max(axis=2) > 12
    assert moved[-40:].mean() > 0.1  # The ball is followed: what moves is the floor.


def test_a_floor_of_its_own_colour_keeps_it(draw):
    red = AIMED.format("").replace('size="0 0 0.1"', 'size="0 0 0.1" rgba="0.9 0.5 0.5 1"')
    floor = draw(red, [[0.0]])[0, -5:]
    assert (floor[..., 0] - floor[..., 1] > 30).all()
    assert np.ptp(floor.reshape(-1, 3), axis=0).max() < 40


def test_bodies_side_by_side_differ_in_colour():
    model = mujoco.MjModel.from_xml_string(APART)
    dress(model, mujoco.MjData(model), 1.0)
    assert np.abs(model.geom_rgba[0] - model.geom_rgba[1]).max() > 0.3


def test_a_window_follows_a_motion_and_a_live_simulation():
    model, data, motion = shown(ROLLING)
    loop = Loop(model, data, motion)
    np.testing.assert_allclose(model.stat.center, loop.lookat)  # Where a viewer's free camera begins.
    loop.advance(1.0)
    assert np.abs(loop.lookat - data.geom_xpos[1])[0] < 0.3
    model = mujoco.MjModel.from_xml_string(ROLLING)
    live = Live(model, data := start(model))
    np.testing.assert_allclose(model.stat.center, live.lookat)
    assert np.abs(live.lookat - data.geom_xpos[1]).max() < 0.3
    for _ in range(100):
        live.advance(0.03)
    assert data.geom_xpos[1, 0] > 2
    assert np.abs(live.lookat - data.geom_xpos[1])[0] < 0.5


def test_a_live_simulation_that_shakes_in_its_place_moves_no_camera():
    model = mujoco.MjModel.from_xml_string(ARM)
    live = Live(model, start(model))
    before = live.lookat.copy()
    for _ in range(30):
        live.advance(0.05)
    np.testing.assert_array_equal(live.lookat, before)


DRIVEN = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" rgba="1 1 1 1"/></body>
  </worldbody><actuator><motor name="push" joint="x" ctrlrange="-1 1"/></actuator></mujoco>"""


def driven(ctrl: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(DRIVEN)
    motion = Motion(np.linspace(0, 1, len(ctrl)), np.zeros((len(ctrl), 1)), ctrl[:, None])
    return render(model, start(model), motion, (160, 120)).images.astype(int)


def test_controls_that_change_are_drawn_below_with_the_moment(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    ctrl = np.linspace(-1, 1, 11)
    frames = driven(ctrl)
    assert frames.shape == (11, 120, 160, 3)
    strip = frames[:, 100:]  # The lower sixth.
    marks = [np.flatnonzero((image < 60).all(axis=(0, 2))) for image in strip]
    np.testing.assert_allclose([mark.mean() for mark in marks], 0.5 + 158 * np.linspace(0, 1, 11), atol=1)
    blue = (strip[0, :, :, 2] - strip[0, :, :, 0]) > 60
    columns = np.flatnonzero(blue[7:].any(axis=0))
    heights = [
        np.flatnonzero(blue[7:, column]).mean() for column in (columns[5], columns[len(columns) // 2], columns[-5])
    ]
    assert heights[0] > heights[1] + 2 > heights[2] + 4  # From the lower edge to the upper.


def test_constant_controls_take_no_room(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    frames = driven(0.5 + 1e-7 * np.arange(3))
    assert frames.shape == (3, 120, 160, 3)
    assert not ((frames[..., 2] - frames[..., 0]) > 60).any()


def test_a_floor_with_a_texture_shows_the_way_in_a_drawing_too(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    asset = """<mujoco><asset><texture name="t" type="2d" builtin="checker" width="8" height="8"/>
      <material name="m" texture="t"/></asset>"""
    xml = ROLLING.replace("<mujoco>", asset, 1).replace('type="plane"', 'type="plane" material="m"')
    model = mujoco.MjModel.from_xml_string(xml)
    motion = Motion(np.arange(2.0), np.array([[x, 0, 0.1, 1, 0, 0, 0] for x in (0.0, 1.03)]))
    images = render(model, start(model), motion, (320, 180)).images.astype(int)
    assert (np.abs(images[1] - images[0])[-40:].max(axis=2) > 12).mean() > 0.1
