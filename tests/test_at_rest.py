"""Where MJX's own derivative is zero or NaN in silence.

Rotations at rest, impedances whose power is not whole, and time constants that MJX raises.
"""

import threading

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.stepping._mjx import make_data, mended, mjx, put_model
from tog_mjx.stepping.integration import positions_after
from tog_mjx.stepping.safe import impedance, rotation_vector

AT_REST = """<mujoco><option tolerance="1e-14" iterations="50" ls_iterations="50"/>
  <default><geom contype="0" conaffinity="0"/></default><worldbody>
  <site name="reference"/><geom name="floor" type="plane" size="1 1 1" contype="1" conaffinity="1" solimp="{solimp}"/>
  <body pos="1 0 1"><joint type="ball" stiffness="10"/><geom size=".1" pos=".2 0 0"/></body>
  <body pos="2 0 1"><joint type="free" stiffness="10"/><geom type="box" size=".1 .12 .15"/></body>
  <body pos="3 0 1"><joint name="servo" type="ball"/><geom size=".1" pos=".2 0 0"/></body>
  <body pos="0 0 .3"><joint type="ball" pos=".1 0 0"/><geom size=".1"/><site name="moving"/></body>
  <body pos="9 0 .5"><joint type="slide" axis="0 0 1"/><geom size=".1" contype="1" solimp="{solimp}"/></body>
  <site name="hook" pos="4 0 1"/><site name="inside" pos="4 0 .7"/><site name="on axis" pos="4 0 1.4"/>
  <site name="behind" pos="4 -.3 1.3"/>
  <geom name="ball" size=".1" pos="4 0 1.2"/><geom name="reel" type="cylinder" size=".1 .1" pos="4 0 .7"/>
  <body pos="4 0 1"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/><geom size=".1"/>
  <site name="hung"/><site name="aside" pos=".4 .05 .1"/></body>
  </worldbody><tendon><spatial stiffness="5" springlength="0"><site site="hook"/><site site="hung"/></spatial>
  <spatial stiffness="5" springlength=".1"><site site="on axis"/><geom geom="ball"/><site site="aside"/></spatial>
  <spatial stiffness="5" springlength=".1"><site site="behind"/><geom geom="reel" sidesite="inside"/>
  <site site="aside"/></spatial></tendon><actuator><position joint="servo" gear="1 .5 .3" kp="20"/>
  <position site="moving" refsite="reference" gear="0 0 0 .4 .5 .6" kp="10"/></actuator></mujoco>"""


def test_a_step_from_rest_has_the_derivative_of_differences():
    """Against C MuJoCo, at the point where every model starts that nobody has turned; the sphere is in the air."""
    model = mujoco.MjModel.from_xml_string(AT_REST.format(solimp=".9 .95 .001 .5 1.3"))
    mjx_model, n = put_model(model), model.nv
    start = make_data(mjx_model)

    @compile_quickly
    def jacobians(x):
        def after(x):
            qpos = positions_after(mjx_model, start.qpos, x[:n])
            return tog.step(mjx_model, start.replace(qpos=qpos, qvel=x[n : 2 * n], ctrl=x[2 * n :])).qvel

        _, push = jax.linearize(after, x)
        pull = jax.linear_transpose(push, x)
        return jax.vmap(push)(jnp.eye(x.size)).T, jax.vmap(lambda row: pull(row)[0])(jnp.eye(n))

    def after_in_c(x):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, x[:n], 1.0)
        data.qvel[:], data.ctrl[:] = x[n : 2 * n], x[2 * n :]
        mujoco.mj_step(model, data)
        return data.qvel.copy()

    zero = np.zeros(2 * n + model.nu)
    slopes = [
        np.array([(after_in_c(h * row) - after_in_c(-h * row)) / (2 * h) for row in np.eye(zero.size)]).T
        for h in (1e-3, 5e-4)
    ]
    expected = (4 * slopes[1] - slopes[0]) / 3
    turning = expected[:n, :n][np.r_[0:3, 6:15]][:, np.r_[0:3, 6:15]]  # Of rotations by rotations.
    assert np.abs(turning).max(axis=1).min() > 0.01
    for found in jacobians(zero):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.9e-3, 2.1e-3, 0.3, 3.0])
def test_a_rotation_vector_is_that_of_its_quaternion(angle, sign):
    axis = np.array([0.6, 0.0, 0.8])
    quaternion = sign * jnp.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    np.testing.assert_allclose(rotation_vector(quaternion), angle * axis, rtol=1e-12, atol=1e-15)
    # Turned a little about its own axis, and across: derivatives of the exponential's inverse.
    mode = jax.jacfwd if sign == 1 else jax.jacrev
    turned = jnp.array([-jnp.sin(angle / 2), *(jnp.cos(angle / 2) * axis)]) / 2
    np.testing.assert_allclose(sign * mode(rotation_vector)(quaternion) @ turned, axis, rtol=1e-9, atol=1e-12)
    across = jnp.array([0.0, 0.0, np.sin(angle / 2) if angle else 0.5, 0.0])
    expected = [0, angle if angle else 1.0, 0]
    np.testing.assert_allclose(sign * mode(rotation_vector)(quaternion) @ across, expected, rtol=1e-9, atol=1e-12)


SOLIMPS = (
    (0.9, 0.95, 1e-3, 0.5, 2.0),
    (0.0, 0.95, 0.01, 0.3, 1.3),
    (0.2, 0.9, 0.01, 0.6, 1.0),
    (0.95, 0.9, 1e-3, 0.5, 2),
)


@pytest.mark.parametrize("solimp", SOLIMPS)
def test_an_impedance_is_mjxs_and_has_its_derivative(solimp):
    violations = jnp.array([-0.02, -0.004, -3e-4, 3e-4, 7e-4, 0.004, 0.008, 0.02])
    model = put_model(mujoco.MjModel.from_xml_string("<mujoco/>"))
    solref, given = jnp.array([0.02, 1.0]), jnp.array(solimp)
    kbi = mjx._src.constraint._kbi
    with mended():
        ours = jax.vmap(lambda r: mjx._src.constraint._kbi(model, solref, given, r)[2])(violations)
    assert mjx._src.constraint._kbi is kbi
    stock = jax.vmap(lambda r: kbi(model, solref, given, r)[2])
    np.testing.assert_array_equal(ours, stock(violations))
    np.testing.assert_allclose(jax.vmap(impedance, (None, 0))(given, violations), ours, rtol=1e-13)
    slopes = jax.vmap(jax.grad(impedance, 1), (None, 0))(given, violations)
    np.testing.assert_allclose(
        slopes, (stock(violations + 1e-8) - stock(violations - 1e-8)) / 2e-8, rtol=1e-5, atol=1e-6
    )
    by_solimp = jax.vmap(jax.grad(impedance), (None, 0))(given, violations)
    forward = jax.vmap(jax.jacfwd(impedance), (None, 0))(given, violations)
    np.testing.assert_allclose(by_solimp, forward, rtol=1e-12, atol=1e-15)
    second = jax.grad(jax.grad(impedance, 1), 1)(given, 0.0)
    d0, d1, width, mid, power = solimp
    if power == 2 and d0 < d1:  # d0 + (d1 - d0) (r / width)^2 / mid.
        np.testing.assert_allclose(second, 2 * (d1 - d0) / width**2 / mid, rtol=1e-12)
    assert np.isfinite(second)


CYLINDER = jnp.array([0.3, 0.5, 0.0])
POINTS = jnp.array(
    [
        [0.1, -0.2, 0.1],
        [0.02, 0.01, 0.4],
        [0.3, 0.2, 0.1],
        [0.1, 0.1, -0.7],
        [0.3, -0.3, 0.6],
        [0, 0, 0.45],
        [0, 0, -0.6],
    ]
)
"""In a cylinder near its side and its end, beyond its side, its end and its edge, and on its axis."""


def test_a_cylinders_distance_is_mjxs_and_has_its_derivatives_of_two_orders():
    """Its slope is a contact's normal; stock MJX's is NaN in reverse mode, and does not see the size."""
    at = lambda function: jax.jit(jax.vmap(function))  # noqa: E731
    sizes = jnp.tile(CYLINDER, (len(POINTS), 1))
    stock, stock_slope = at(mjx._src.collision_sdf._cylinder), at(mjx._src.collision_sdf._cylinder_grad)
    with mended():
        ours = mjx._src.collision_sdf._cylinder
        value, slope = at(jax.value_and_grad(ours))(POINTS, sizes)
        by_size = at(jax.grad(ours, 1))(POINTS, sizes)
        both = [at(mode(jax.grad(ours), (0, 1)))(POINTS, sizes) for mode in (jax.jacfwd, jax.jacrev)]
    np.testing.assert_array_equal(value, stock(POINTS, sizes))
    np.testing.assert_array_equal(slope, stock_slope(POINTS, sizes))

    def differences(function):
        moves = 1e-6 * np.eye(6).reshape(6, 2, 1, 3)
        slopes = [(function(POINTS + a, sizes + b) - function(POINTS - a, sizes - b)) / 2e-6 for a, b in moves]
        return np.stack(slopes, axis=-1)

    np.testing.assert_allclose(by_size, differences(stock)[:, 3:], rtol=0, atol=1e-9)
    off_axis = differences(stock_slope)[:-2]
    for found in both:
        np.testing.assert_allclose(np.concatenate(found, axis=-1)[:-2], off_axis, rtol=0, atol=1e-7)
        np.testing.assert_allclose(found[0][-2:], 0.0, rtol=0, atol=1e-12)


def test_a_muscle_has_its_derivative_in_single_precision():
    """MJX divides by a width of zero, and raises that to the fifth power: infinite in float32, though not selected."""

    def speed(ctrl, act):
        return mjx._src.support.muscle_dynamics(ctrl, act, jnp.array([0.01, 0.04, 0.0]))

    with jax.enable_x64(False):
        at = jnp.float32(0.7), jnp.float32(0.2)
        stock = speed(*at)
        with mended():
            value, slopes = jax.value_and_grad(speed, (0, 1))(*at)
    assert value == stock
    tau = 0.01 * (0.5 + 1.5 * 0.2)
    np.testing.assert_allclose(slopes, (1 / tau, -1 / tau - 0.5 * 1.5 * 0.01 / tau**2), rtol=1e-5)


def test_mjx_is_as_it_was_when_the_last_thread_is_out():
    stock, inside, leave = mjx._src.math.quat_to_axis_angle, threading.Event(), threading.Event()

    def stay():
        with mended():
            inside.set()
            leave.wait()

    other = threading.Thread(target=stay)
    other.start()
    inside.wait()
    with pytest.raises(ZeroDivisionError), mended():
        raise ZeroDivisionError
    assert mjx._src.math.quat_to_axis_angle is not stock
    leave.set()
    other.join()
    assert mjx._src.math.quat_to_axis_angle is stock
    assert mjx._src.support.jp is jnp


def test_a_solref_below_two_time_steps_has_the_derivative_zero():
    xml = """<mujoco><option timestep="0.01"/><worldbody><geom type="plane" size="5 5 .1" solref="{0} 1"/>
      <body pos="0 0 .099"><joint type="slide" axis="0 0 1"/><geom size=".1" condim="1" solref="{0} 1"/></body>
      </worldbody></mujoco>"""

    @jax.jit
    def slope(model: mjx.Model) -> jax.Array:
        def speed(t: jax.Array) -> jax.Array:
            moved = model.replace(geom_solref=model.geom_solref.at[:, 0].add(t))
            return tog.step(moved, make_data(moved).replace(qvel=jnp.array([-1.0]))).qvel[0]

        return jax.jvp(speed, (0.0,), (1.0,))[1]

    slopes = [float(slope(put_model(mujoco.MjModel.from_xml_string(xml.format(t))))) for t in (0.005, 0.03)]
    assert slopes[0] == 0
    assert abs(slopes[1]) > 1
