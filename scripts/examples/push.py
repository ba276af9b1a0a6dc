"""A ball pushes a cube over a table to a goal, and is itself pulled no farther than it must be."""

import mujoco

import tog_mjx as tog

MODEL = mujoco.MjSpec.from_string("""<mujoco model="push"> <option timestep="0.005"/>
  <default> <geom friction="0.4" solref="0.04 1" solimp="0 0.9 0.02"/>
    <position kp="40" dampratio="1" ctrlrange="-1 1"/> </default>
  <worldbody> <geom type="plane" size="1 1 0.1"/> <site pos="0.4 0.2 0" size="0.03" rgba="0 0.6 0.4 1"/>
    <body name="cube" pos="0 0 0.09"> <freejoint/> <geom type="box" size="0.1 0.1 0.1" mass="0.5"/> </body>
    <body name="ball" pos="-0.3 0 0.1"> <geom size="0.05" mass="0.2"/>
      <joint name="x" type="slide" axis="1 0 0"/> <joint name="y" type="slide" axis="0 1 0"/> </body> </worldbody>
  <contact> <exclude body1="world" body2="ball"/> </contact>
  <actuator> <position name="x" joint="x"/> <position name="y" joint="y"/> </actuator></mujoco>""")


def push() -> tog.Problem:
    def miss(last):
        return (last.body("cube")[0] - 0.4) ** 2 + (last.body("cube")[1] - 0.2) ** 2

    def effort(state):
        return 0.01 * state.ctrl @ state.ctrl

    return tog.Problem(MODEL, 200, tog.Controls(knots=3), miss, effort, guess=[0.2, 0] * 3, success=0.01)
