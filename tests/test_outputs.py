"""What is asked of the last state: all that follows from it is there, its value and its derivative in both modes."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.problems.outputs import Outputs
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.problems.wrt import Displacements
from tog_mjx.stepping._mjx import put_model
from tog_mjx.stepping.complete import complete
from tog_mjx.stepping.mjx_state import on_mjx

STEPS, SHORT = 40, 1e-5
HAND = """<mujoco>
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="table" type="plane" size="1 1 .1" friction=".5"/>
    <body name="hand" pos="0 0 .2">
      <joint name="lift" type="slide" axis="0 0 1" damping="2"/><geom size=".04" mass=".2" pos="0 0 .1"/>
      <body name="finger"><joint name="swing" axis="0 1 0" damping=".1" stiffness="2"/>
        <geom name="tip" type="capsule" size=".02" fromto="0 0 0 .02 0 -.1802" mass=".3"/>
        <site name="pad" pos=".02 0 -.18" size=".03" euler="0 30 10"/></body>
    </body>
  </worldbody>
  <actuator><motor joint="lift"/><general joint="swing" dyntype="filter" dynprm=".05" gainprm="2"/></actuator>
  <sensor>
    <touch name="touch" site="pad"/><force site="pad"/><torque site="pad"/><accelerometer name="felt" site="pad"/>
    <gyro site="pad"/><framelinacc objtype="body" objname="finger"/><actuatorfrc actuator="lift_motor"/>
    <subtreeangmom body="hand"/><jointvel joint="swing"/><framepos objtype="site" objname="pad"/>
  </sensor>
</mujoco>""".replace('<motor joint="lift"/>', '<motor name="lift_motor" joint="lift"/>')
PUBLIC = (
    "sensordata", "qacc", "act_dot", "qfrc_constraint", "qfrc_smooth", "qacc_smooth", "qfrc_actuator", "actuator_force",
    "actuator_length", "qfrc_passive", "qfrc_bias", "cvel", "cdof_dot", "xpos", "xipos", "geom_xpos", "subtree_com",
)  # fmt: skip
PRIVATE = ("cacc", "cfrc_int", "cfrc_ext", "subtree_linvel", "subtree_angmom", "actuator_velocity")


def in_c(model: mujoco.MjModel, steps: int, ctrl: np.ndarray) -> mujoco.MjData:
    """The last state, with all that follows from it."""
    data = mujoco.MjData(model)
    data.ctrl[:] = ctrl
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data


def fields(data) -> dict:
    private = getattr(data, "_impl", data)
    return {**{name: getattr(data, name) for name in PUBLIC}, **{name: getattr(private, name) for name in PRIVATE}}


def test_what_follows_from_the_last_state_is_that_of_c_mujoco():
    """The finger is pressed on the table and drawn along it."""
    model = mujoco.MjModel.from_xml_string(HAND)
    on, ctrl, along = put_model(model), np.array([-3.0, 0.5]), np.array([1.0, 0.3])
    start = on_mjx(on, mujoco.MjData(model))

    def found(amount):
        end, _ = tog.simulate(on, start, jnp.asarray(ctrl) + amount * along, STEPS)
        return fields(complete(on, end, "implicit"))

    value, slope = jax.jit(lambda: jax.jvp(found, (0.0,), (1.0,)))()
    expected, ahead, behind = (fields(in_c(model, STEPS, ctrl + h * along)) for h in (0, SHORT, -SHORT))
    assert expected["sensordata"][0] > 3  # It presses.
    weights = {name: np.random.default_rng(0).normal(size=part.shape) for name, part in expected.items()}
    total = 0.0
    for name, part in expected.items():
        settled = (ahead[name] - behind[name]) / (2 * SHORT)
        np.testing.assert_allclose(value[name], part, rtol=0, atol=1e-7 * (1 + np.abs(part).max()), err_msg=name)
        np.testing.assert_allclose(slope[name], settled, rtol=0, atol=1e-5 * (1 + np.abs(settled).max()), err_msg=name)
        total += (weights[name] * slope[name]).sum()
    backward = jax.jit(jax.grad(lambda amount: sum((weights[n] * part).sum() for n, part in found(amount).items())))
    np.testing.assert_allclose(backward(0.0), total, rtol=1e-8)


@pytest.mark.parametrize("differentiation", ["implicit", "native"])
def test_an_accelerometer_feels_where_nothing_can_touch(differentiation):
    """MJX itself leaves it at zero."""
    xml = """<mujoco><worldbody><body><joint axis="0 1 0"/><geom size=".1" pos="{} 0 0"/><site name="s" pos=".3 0 0"/>
      </body></worldbody><sensor><accelerometer name="felt" site="s"/></sensor></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml.format(0.5))
    on, data = put_model(model), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    y = Outputs(model, "felt", differentiation)
    assert y.names == ("felt[0]", "felt[1]", "felt[2]")
    np.testing.assert_allclose(jax.jit(y.observe)(on, on_mjx(on, data)), data.sensordata, atol=1e-12)
    assert data.sensordata[2] > 3


PRESS = """<mujoco model="press">
  <option timestep="0.002"/>
  <worldbody>
    <geom name="table" type="plane" size="1 1 .1"/>
    <body name="finger" pos="0 0 .06"><joint name="z" type="slide" axis="0 0 1" damping="2"/>
      <geom name="tip" size=".05" mass=".3"/><site name="pad" pos="0 0 -.05" size=".02"/></body>
  </worldbody>
  <actuator><motor name="push" joint="z"/></actuator>
  <sensor><touch name="touch" site="pad"/><jointvel name="pad" joint="z"/></sensor>
  <keyframe><key name="p" ctrl="-4"/></keyframe>
</mujoco>"""


def effort(data):
    return data.site_xpos[0, 2] + 1e-3 * (data.qfrc_constraint**2).sum()


def test_the_last_state_of_a_press():
    """A force holds finger, weight and push, 0.3 x 9.81 + 4 N; a sensor and a site have the same name."""
    model = mujoco.MjModel.from_xml_string(PRESS)
    start = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, start, 0)
    motion = Simulation(SceneFunction(model, start, 100, "ctrl", effort), np.eye(1), states=False).run()
    ahead, behind = (effort(in_c(model, 100, np.array([-4.0 + h]))) for h in (SHORT, -SHORT))
    np.testing.assert_allclose(motion.slopes, (ahead - behind) / (2 * SHORT), rtol=1e-6)
    np.testing.assert_allclose([motion.value[0], motion.slopes[0, 0]], [0.0476, -0.0138], rtol=2e-3)


def test_outputs_are_sensors_sites_and_accelerations():
    model = mujoco.MjModel.from_xml_string(PRESS)
    read = {
        "touch": lambda data: data.sensordata[0],
        "sensor:pad": lambda data: data.sensordata[1],
        "pad[2]": lambda data: data.site_xpos[0, 2],
        "acc": lambda data: data.qacc[0],
        "qvel": lambda data: data.qvel[0],
    }
    asked = [Outputs(model, name, "implicit") for name in read]
    assert [y.names[0] for y in asked] == ["touch[0]", "sensor:pad[0]", "pad.z", "acc[0]", "qvel[0]"]
    on, start = put_model(model), on_mjx(put_model(model), mujoco.MjData(model))

    def found(push):
        end, _ = tog.simulate(on, start, push, 60)
        return jnp.concatenate([y.observe(on, end) for y in asked])

    value, slope = jax.jit(lambda x: jax.jvp(found, (x,), (jnp.ones(1),)))(jnp.array([-4.0]))
    centre, ahead, behind = (
        np.array([some(data) for some in read.values()])
        for data in (in_c(model, 60, np.array([-4.0 + h])) for h in (0, SHORT, -SHORT))
    )
    np.testing.assert_allclose(value, centre, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * SHORT), rtol=1e-5, atol=1e-8)
    assert value[0] > 6
    assert slope[0] < -0.9


LED = """<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="led" mocap="true" pos="0 0 .1" quat=".9 .1 .3 .2"/>
    <body name="box" pos=".02 0 .1" quat=".9 .2 .3 .2"><freejoint/><geom type="box" size=".05 .04 .03" mass="1"
      contype="0" conaffinity="0"/></body>
    <body pos="1 0 0"><joint name="x" type="slide" axis="1 0 0" damping="1"/><geom size=".1" mass="1"/></body>
  </worldbody>
  <equality><weld body1="led" body2="box"/></equality>
  <actuator><intvelocity name="servo" joint="x" kp="20" actrange="-1 1"/></actuator>
</mujoco>"""


def test_activations_and_mocap_bodies_are_variables():
    """A rotation is displaced as `mju_quatIntegrate` does it."""
    model = mujoco.MjModel.from_xml_string(LED)
    arrays: dict[str, tuple[str, ...]] = {"act": ("act[0]",)}
    arrays |= {name: tuple(f"{name}[0, {i}]" for i in range(3)) for name in ("mocap_pos", "mocap_quat")}
    variables = [Displacements(model, array) for array in arrays]
    assert [x.names for x in variables] == list(arrays.values())
    assert [x.kin.tolist() for x in variables] == [[0], [0] * 3, [0] * 3]
    on, start = put_model(model), on_mjx(put_model(model), mujoco.MjData(model))

    def end(x):
        moved = {name: getattr(start, name) for name in arrays}
        for some, part in zip(variables, jnp.split(x, [1, 4]), strict=True):
            _, moved = some.place(part, on, moved)
        data = start.replace(**moved)
        return tog.simulate(on, data, data.ctrl, 30)[0].qvel

    def end_in_c(x: np.ndarray) -> np.ndarray:
        data = mujoco.MjData(model)
        data.act[:] += x[:1]
        data.mocap_pos[0] += x[1:4]
        mujoco.mju_quatIntegrate(data.mocap_quat[0], x[4:], 1)
        mujoco.mj_step(model, data, 30)
        return data.qvel.copy()

    along = jax.vmap(lambda v: jax.jvp(end, (jnp.zeros(7),), (v,)), out_axes=(None, 1))
    value, slopes = jax.jit(along)(jnp.eye(7))
    settled = np.stack([(end_in_c(SHORT * e) - end_in_c(-SHORT * e)) / (2 * SHORT) for e in np.eye(7)], axis=1)
    assert (np.abs(settled).max(axis=0) > 0.1).all()
    np.testing.assert_allclose(slopes, settled, rtol=0, atol=1e-5 * np.abs(settled).max())
    np.testing.assert_allclose(value, end_in_c(np.zeros(7)), atol=1e-8)
