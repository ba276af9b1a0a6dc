"""Tendons that have no direction, or a clamp at no force, where MJX has no derivative: the preflight says so."""

import jax
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.file.preflight import preflight
from tog_mjx.stepping._mjx import make_data, put_model


@pytest.mark.parametrize(
    ("tendon", "told"),
    [
        ('stiffness="5" springlength="0"', 0),  # Its spring is at rest, and has its derivative.
        ('stiffness="5" springlength=".1"', 1),
        ('stiffness="5" springlength="0" damping="1"', 1),
        ('limited="true" range="0 1"', 1),
        ("", 0),
    ],
)
def test_a_tendon_of_length_zero_has_no_direction(tendon, told):
    xml = f"""<mujoco><worldbody><site name="a" pos="0 0 .3"/><body pos="0 0 .3"><joint type="slide" axis="0 0 1"/>
      <geom size=".1"/><site name="b" pos="{{}}"/></body></worldbody><tendon><spatial name="band" {tendon}>
      <site site="a"/><site site="b"/></spatial></tendon></mujoco>"""
    for place, number in (("0 0 0", told), ("0 0 .1", 0)):
        found = preflight(mujoco.MjModel.from_xml_string(xml.format(place)))
        assert [remark.what for remark in found] == [
            "tendon band: two of its sites are in one place, where it has no direction"
        ] * number


@pytest.mark.parametrize("ctrl", [0.0, 0.5])
def test_a_clamped_tendon_without_force_is_nan_in_reverse_mode(ctrl):
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
      <geom size=".1" pos=".2 0 0"/></body></worldbody><tendon><fixed name="cord" actuatorfrcrange="-1 1">
      <joint joint="hinge" coef="1"/></fixed></tendon><actuator><motor tendon="cord"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    data.ctrl[:] = ctrl
    found = preflight(model, data=data)
    assert ["actuatorfrcrange of tendon cord: reverse mode is NaN" in remark.what for remark in found] == [True] * (
        not ctrl
    )
    at = put_model(model)
    start = make_data(at)
    slope = jax.jit(jax.grad(lambda u: tog.step(at, start.replace(ctrl=u)).qvel[0]))(data.ctrl)
    assert np.isnan(slope).any() == bool(found)
