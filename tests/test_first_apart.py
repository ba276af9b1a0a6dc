"""Where MJX and C MuJoCo part: the first stage of a step that differs, and that parity names it."""

import mujoco
import numpy as np
import pytest

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.measured.first_apart import first_apart
from tog_mjx.checks.measured.parity import parity
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.keyframes import keyframe_start
from tog_mjx.problems.scene_function import SceneFunction

# A ball on a string, swung in a circle of 0.3 m at 3 rad/s: omega^2 r is 2.7 m/s^2.
STRING = """<mujoco><option timestep="0.002"/><worldbody>
  <body name="arm" pos="0 0 .8"><joint name="swing" axis="0 1 0"/>
  <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".3" contype="0" conaffinity="0"/></body>
  <body name="bob" pos=".3 0 .5"><freejoint/><geom size=".05" mass=".4" contype="0" conaffinity="0"/></body>
  </worldbody>
  <equality><connect name="string" body1="arm" body2="bob" anchor=".3 0 0" solref=".05 1"/></equality>
  <keyframe><key qvel="3  .9 0 0 0 3 0"/></keyframe></mujoco>"""
# A capsule against a cylinder, which MJX collides by iterations of its own, and a limit, a dry friction and a floor.
ROWS = """<mujoco>
  <option iterations="{iterations}" ls_iterations="50" tolerance="1e-12" cone="elliptic" jacobian="{jacobian}"/>
  <worldbody><geom name="floor" type="plane" size="5 5 .1"/>
  <geom name="post" type="cylinder" size=".1 .2" pos="2 0 0"/>
  <body pos="0 0 .099"><freejoint/><geom name="ball" size=".1"/>
  <body pos=".3 0 .2"><joint axis="0 1 0" frictionloss=".1" limited="true" range="-20 20"/>
  <geom size=".05" pos=".1 0 0"/></body></body>
  <body pos="{x} 0 .24"><freejoint/><geom name="rod" type="capsule" size=".05 .1" euler="0 80 10"/></body>
  </worldbody>
  <keyframe><key qpos="0 0 .099 1 0 0 0 .4  {x} 0 .24 1 0 0 0" qvel="1 .5 0 0 1 2 3  0 0 -1 2 1 0"/></keyframe>
  </mujoco>"""
# A steep rod that slides on a floor. MJX takes the y axis for a tangent, and C MuJoCo the rod's, at atan2(1, 3).
ROD = """<mujoco><option iterations="100" ls_iterations="50" tolerance="1e-12" cone="{cone}"/><worldbody>
  <geom name="floor" type="plane" size="5 5 .1" friction=".5"/>
  <body pos="0 0 .19"><freejoint/><geom name="rod" type="capsule" size=".05 .15" zaxis=".3 .1 {up}"
  friction=".5"/></body>
  </worldbody><keyframe><key qpos="0 0 {z} 1 0 0 0" qvel="1 .5 -.5 0 1 .3"/></keyframe></mujoco>"""
STEEP, FLAT = {"up": 0.9, "z": 0.190518}, {"up": 0.4, "z": 0.166676}
"""1 mm deep."""


def apart(xml: str):
    model = mujoco.MjModel.from_xml_string(xml)
    return first_apart(model, keyframe_start(model))


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_where_the_engines_agree_nothing_is_named(jacobian):
    assert apart(ROWS.format(iterations=100, jacobian=jacobian, x=3)) is None


def test_contacts_and_solvers_are_told_apart():
    found = apart(ROWS.format(iterations=100, jacobian="dense", x=2.05))
    assert "the contact of geom post with geom rod" in found.what
    assert "spheres" in found.remedy
    found = apart(ROWS.format(iterations=1, jacobian="dense", x=3).replace('ls_iterations="50"', 'ls_iterations="1"'))
    assert found.what == "its solver's answer"
    assert found.remedy == "give both engines more iterations, of the line search too"


def test_a_string_that_is_swung_is_named_and_no_collision():
    model = mujoco.MjModel.from_xml_string(STRING)
    start = keyframe_start(model)
    simulation = Simulation(SceneFunction(model, start, 3, "qvel"), np.eye(model.nv, 1))
    found = parity(simulation, simulation.run())
    assert found.level == Level.CARE
    assert "they part in the reference acceleration of equality string, by 2." in found.sentence
    assert found.sentence.endswith("MJX leaves out the part that grows with the square of the angular speed")
    assert "spheres" not in found.remedy
    assert apart(STRING).what.startswith("the reference acceleration of equality string, by 2.7 m/s^2")
    (remark,) = preflight(model, data=start)
    assert "<connect> string: MJX leaves out the part of its reference acceleration" in remark.what
    assert remark.measured_by == found.check
    assert apart(STRING.replace('qvel="3  .9 0 0 0 3 0"', 'qvel="0  0 0 0 0 0 0"')) is None


def test_where_the_axes_of_a_friction_pyramid_differ_they_are_named():
    """The sum over its edges, by which rows are compared, does not depend on them; an elliptic cone has none."""
    found = apart(ROD.format(cone="pyramidal", **STEEP))
    told = "18 degrees in the tangents that its friction depends on"
    assert found.what == f"the contact of geom floor with geom rod: {told}"
    assert found.remedy == "set cone='elliptic', which has no tangents"
    model = mujoco.MjModel.from_xml_string(ROD.format(cone="pyramidal", **STEEP))
    (remark,) = preflight(model, data=keyframe_start(model))
    assert "the axes of its friction pyramid are not those of C MuJoCo" in remark.what
    for fine in ({"cone": "elliptic", **STEEP}, {"cone": "pyramidal", **FLAT}):
        assert apart(ROD.format(**fine)) is None


@pytest.mark.parametrize(
    ("shift", "turn", "what"),
    [
        ((0.0, 0.003, 0.0), 0.0, "0.003 m in its points"),
        ((0.0, 0.0, 0.0), 2.0, "2 degrees in its normal"),
    ],
)
def test_points_and_normals_of_contacts_are_told_apart(shift, turn, what, monkeypatch):
    """Where C MuJoCo's have been moved by hand."""
    model = mujoco.MjModel.from_xml_string(ROD.format(cone="elliptic", **STEEP))
    forward, (cos, sin) = mujoco.mj_forward, (np.cos(np.radians(turn)), np.sin(np.radians(turn)))

    def moved(model, data):
        forward(model, data)
        contact = data.contact[0]
        contact.pos[:] += shift
        contact.frame[:] = (np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) @ contact.frame.reshape(3, 3)).ravel()
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_referenceConstraint(model, data)

    start = keyframe_start(model)
    monkeypatch.setattr(mujoco, "mj_forward", moved)
    found = first_apart(model, start)
    assert found is not None
    assert found.what == f"the contact of geom floor with geom rod: {what}"
    assert "spheres" in found.remedy
