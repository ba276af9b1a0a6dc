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
