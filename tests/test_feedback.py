"""Controls that are a function of state and time, against C MuJoCo's control callback."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.stepping._mjx import make_data, mjx, put_model

XML = """<mujoco><option timestep="0.01"/><worldbody>
  <body><joint name="rail" type="slide" axis="1 0 0" damping="0.1"/><geom name="cart" size="0.1" mass="1"/>
    <body><joint name="hinge" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.5" mass="0.2"/>
      <site name="tip" pos="0 0 0.5"/></body></body>
  </worldbody><actuator><motor joint="rail"/></actuator>
  <sensor><framelinvel objtype="site" objname="tip"/></sensor></mujoco>"""
"""A pole on a cart."""
STEPS = 100
GAINS = np.array([4.0, 3.0, -30.0, -5.0])
"""Of the cart's position and speed and of the tip's, the pole's angle left aside."""


def force(gains, state, time):
    """Feedback of what follows from the state, and something in time."""
    seen = (state.qpos[0] - 0.3, state.qvel[0], state.site_xpos[0, 0] - state.qpos[0], state.sensordata[0])
    return -sum(gain * number for gain, number in zip(gains, seen, strict=True)) + jnp.sin(9 * time)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture(scope="module")
def data(model) -> mjx.Data:
    return make_data(model).replace(qpos=jnp.array([0.0, 0.2]))


def motion_in_c(model: mujoco.MjModel, gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions [STEPS, nq], and the last controls."""

    def control(_, data):
        data.ctrl[0] = force(gains, data, data.time)

    data, found = mujoco.MjData(model), []
    data.qpos[:] = [0.0, 0.2]
    mujoco.set_mjcb_control(control)
    try:
        for _ in range(STEPS):
            mujoco.mj_step(model, data)
            found.append(data.qpos.copy())
    finally:
        mujoco.set_mjcb_control(None)
    return np.array(found), data.ctrl


def test_a_function_sees_the_state_as_mujocos_control_callback_does(model, data):
    last, (qpos, _) = tog.simulate(put_model(model), data, lambda state, time: [force(GAINS, state, time)], STEPS)
    expected, ctrl = motion_in_c(model, GAINS)
    np.testing.assert_allclose(qpos, expected, atol=1e-11)
    np.testing.assert_allclose(last.ctrl, ctrl, rtol=1e-9)


def test_gradients_in_the_gains_are_differences_of_c_mujoco_in_both_modes(model, data):
    on_mjx = put_model(model)

    def positions(gains):
        policy = lambda state, time: jnp.array([force(gains, state, time)])  # noqa: E731
        return tog.simulate(on_mjx, data, policy, STEPS)[0].qpos

    h = 1e-4
    ends = [[motion_in_c(model, GAINS + sign * d)[0][-1] for sign in (1, -1)] for d in h * np.eye(4)]
    differences = np.array([(high - low) / (2 * h) for high, low in ends]).T
    forward, backward = jax.jit(lambda k: (jax.jacfwd(positions)(k), jax.jacrev(positions)(k)))(jnp.array(GAINS))
    np.testing.assert_allclose(backward, forward, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(forward, differences, rtol=1e-5, atol=1e-8)
