"""The scenes say what the paper says, and a scene that cannot be used is told in one line."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tog_mjx.mjcf.scene import load_scene, scene_names, scene_path
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.errors import InputError

SPHERE = '<body><freejoint/><geom name="ball" size="0.1"/></body>'


def test_scenes_are_found_by_name_and_by_path():
    assert scene_names() == ["flip", "grasp"]
    path = scene_path("flip")
    assert load_scene(path).model.nq == load_scene("flip").model.nq == 5


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_coordinates_are_world_coordinates(name):
    scene = load_scene(name)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.joints] += np.linspace(0.1, 0.7, len(scene.joints))
    mujoco.mj_forward(scene.model, data)
    x, z, theta = data.qpos[scene.joints[:3]]
    np.testing.assert_allclose(data.body("box").xpos[[0, 2]], [x, z], atol=1e-12)
    up = data.body("box").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(up[[0, 2]], [-np.sin(theta), np.cos(theta)], atol=1e-12)
    for i, finger in enumerate(scene.fingers):
        np.testing.assert_allclose(data.body(finger).xpos[[0, 2]], data.qpos[scene.joints[3 + 2 * i :][:2]], atol=1e-12)


def test_start_and_guess_are_the_papers():
    radius = 0.02
    box, fingers = get_task("flip").scene.start
    np.testing.assert_array_equal(box, [-1, 0.25, np.pi / 2, 0, 0, 0])
    np.testing.assert_allclose(fingers, [[-1.25 - radius, 0.4, 0, 0]])
    np.testing.assert_array_equal(get_task("flip").initial_guess, [0, 0.25])
    box, fingers = get_task("grasp").scene.start
    np.testing.assert_array_equal(box, [0, 0.25, 0, 0, 0, 0])
    np.testing.assert_allclose(fingers, [[-0.3 - radius, 0.25, 0, 0], [0.3 + radius, 0.25, 0, 0]])
    np.testing.assert_array_equal(get_task("grasp").initial_guess, [-0.05, 0.25, 0.05, 0.25])


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_the_markers_stand_at_the_initial_guess(name):
    scene = load_scene(name)
    sites = [scene.model.site(f"setpoint{i + 1}").pos[[0, 2]] for i in range(len(scene.fingers))]
    np.testing.assert_array_equal(np.ravel(sites), scene.initial_guess)


@pytest.mark.parametrize(("name", "stiffness"), [("flip", 10), ("grasp", 40)])
def test_physics_is_the_papers(name, stiffness):
    p = load_scene(name).physics
    assert (p.gravity, p.timestep, p.box_mass, p.finger_mass) == (9.81, 0.001, 1, 0.1)
    np.testing.assert_allclose(p.box_inertia, p.box_mass * 0.5**2 / 6, rtol=1e-12)
    np.testing.assert_array_equal(p.box_half, [0.25, 0.25])
    np.testing.assert_array_equal(np.abs(p.corners), np.full((4, 2), 0.25))
    assert len({tuple(np.sign(corner)) for corner in p.corners}) == 4
    assert p.finger_stiffness == stiffness
    np.testing.assert_allclose(p.finger_damping, 2 * np.sqrt(0.1 * stiffness), rtol=1e-12)
    for law in (p.corner_floor, p.finger_floor, p.finger_box):
        assert (law.stiffness, law.friction, law.slope) == (1000, 0.7, 2)
        np.testing.assert_allclose(law.damping, 2 * np.sqrt(1000), rtol=1e-12)


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ("<mujoco><worldbody><geo/></worldbody></mujoco>", "unrecognized element"),
        ("<mujoco><worldbody>", "XML"),
        (
            f'<mujoco><option integrator="implicit"/><worldbody>{SPHERE}</worldbody></mujoco>',
            "<option integrator='implicit'>",
        ),
        (f'<mujoco><option solver="PGS"/><worldbody>{SPHERE}</worldbody></mujoco>', "<option solver='pgs'>"),
        (
            '<mujoco><worldbody><geom name="wall" type="cylinder" size="1 1"/>'
            '<body><freejoint/><geom name="crate" type="box" size="1 1 1"/></body></worldbody></mujoco>',
            "the collision of geom wall (cylinder) with geom crate (box)",
        ),
        (
            f'<mujoco><worldbody>{SPHERE}</worldbody><sensor><user name="mine" dim="1"/></sensor></mujoco>',
            "sensor mine (type user)",
        ),
        (
            '<mujoco><worldbody><geom name="a" type="box" size="1 1 1"/><geom name="pole" type="cylinder" size="1 1"/>'
            '<body><freejoint/><geom name="b" type="box" size="1 1 1"/></body></worldbody></mujoco>',
            "the collision of geom pole (cylinder) with geom b (box)",
        ),
        (
            f'<mujoco><option><flag energy="enable"/></option><worldbody>{SPHERE}</worldbody></mujoco>',
            "<flag energy='enable'>",
        ),
        (
            f'<mujoco><worldbody>{SPHERE}</worldbody><sensor><contact name="touch" body1="world"/></sensor></mujoco>',
            "sensor touch",
        ),
        (f'<mujoco><option noslip_iterations="3"/><worldbody>{SPHERE}</worldbody></mujoco>', "noslip_iterations='3'"),
        (
            '<mujoco><extension><plugin plugin="mujoco.pid"><instance name="mine"/></plugin></extension><worldbody>'
            '<body><joint name="j"/><geom size="0.1"/></body></worldbody>'
            '<actuator><plugin name="p" joint="j" instance="mine"/></actuator></mujoco>',
            "plugin mine",
        ),
        (
            '<mujoco><worldbody><flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" radius="0.01" '
            'dim="2" mass="1"/></worldbody></mujoco>',
            "flex cloth",
        ),
        (f'<mujoco><option timestep="0"/><worldbody>{SPHERE}</worldbody></mujoco>', "timestep"),
    ],
)
def test_an_unusable_scene_is_one_line_that_names_the_element(tmp_path, xml, message):
    path = tmp_path / "scene.xml"
    path.write_text(xml)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    line = str(caught.value)
    assert message.lower() in line.lower()
    assert line.startswith(str(path))
    assert "\n" not in line


def test_a_missing_scene_names_the_known_ones():
    with pytest.raises(InputError, match=r"nowhere\.xml.*flip, grasp"):
        load_scene("nowhere.xml")


def test_a_missing_scene_says_in_which_folder_a_relative_path_was_sought(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=rf"^a/no\.xml: no such scene or file in {re.escape(str(tmp_path))}; name"):
        load_scene("a/no.xml")
    with pytest.raises(InputError, match=r"no\.xml: no such scene or file; name"):
        load_scene(tmp_path / "no.xml")


def test_a_scene_without_the_planar_parts_says_which_is_missing(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(f"<mujoco><worldbody>{SPHERE}</worldbody></mujoco>")
    with pytest.raises(InputError, match="no body named box"):
        _ = load_scene(path).physics


def save(spec: mujoco.MjSpec, folder: Path) -> Path:
    path = folder / "edited.xml"
    path.write_text(spec.to_xml())
    return path


def test_fingers_that_differ_are_refused(tmp_path):
    spec = mujoco.MjSpec.from_file(str(scene_path("grasp")))
    spec.geom("finger2").mass = 0.2
    with pytest.raises(InputError, match="differ in mass"):
        _ = load_scene(save(spec, tmp_path)).physics


def test_a_box_without_corners_on_the_floor_is_refused(tmp_path):
    spec = mujoco.MjSpec.from_file(str(scene_path("flip")))
    for pair in [pair for pair in spec.pairs if pair.name.startswith("corner")]:
        spec.delete(pair)
    with pytest.raises(InputError, match="no <contact><pair> of a sphere of the box"):
        _ = load_scene(save(spec, tmp_path)).physics


def test_the_inertia_is_that_about_the_hinge(tmp_path):
    # Two weights beside the box, on its diagonal: the principal axes are no longer the box's.
    spec = mujoco.MjSpec.from_file(str(scene_path("flip")))
    for sign in (1, -1):
        spec.body("box").add_geom(size=[0.05, 0, 0], pos=[0.2 * sign, 0.1 * sign, 0], mass=1)
    balls = 2 * (2 / 5 * 0.05**2 + 0.2**2)
    np.testing.assert_allclose(load_scene(save(spec, tmp_path)).physics.box_inertia, 0.5**2 / 6 + balls, rtol=1e-9)
