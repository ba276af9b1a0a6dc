"""Errors and wrong numbers that people meet with MJX: each as stock MJX shows it, and what this package makes of it.

`scripts/findings/errors.md` tells them; scenes are the smallest that show them. What stock MJX of the installed version
does right is held too, so that the page may say so.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.stepping._mjx import contacts, make_data, mjx, put_model

NO_REVERSE = "Reverse-mode differentiation does not work for lax.while_loop"


def in_c(xml: str, x: np.ndarray) -> np.ndarray:
    """The velocity after one converged step of C MuJoCo from (qpos, qvel, ctrl)."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-15
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = np.split(x, [model.nq, model.nq + model.nv])
    mujoco.mj_step(model, data)
    return data.qvel.copy()


def slopes(function, x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Central differences."""
    x = np.asarray(x, float)
    return np.array([(function(x + d) - function(x - d)) / (2 * h) for d in h * np.eye(x.size)]).T


def velocity(step, xml: str):
    """The velocity after one step from (qpos, qvel, ctrl)."""
    model = put_model(mujoco.MjModel.from_xml_string(xml))
    data = make_data(model)

    def after(x):
        qpos, qvel, ctrl = jnp.split(x, [model.nq, model.nq + model.nv])
        return step(model, data.replace(qpos=qpos, qvel=qvel, ctrl=ctrl)).qvel

    return after


def assert_no_reverse_mode(xml: str, x: np.ndarray) -> None:
    with pytest.raises(ValueError, match=NO_REVERSE):
        jax.make_jaxpr(jax.grad(lambda x: velocity(mjx.step, xml)(x).sum()))(jnp.array(x))


def test_conjugate_gradients_in_reverse_mode():
    xml = """<mujoco><option solver="CG"/><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .1">
      <joint type="slide" axis="0 0 1"/><geom size=".1" condim="1"/></body></worldbody></mujoco>"""
    x = np.array([-3e-4, -0.5])
    assert_no_reverse_mode(xml, x)
    found = compile_quickly(jax.jacrev(velocity(tog.step, xml)))(jnp.array(x))
    np.testing.assert_allclose(found, slopes(lambda x: in_c(xml, x), x), rtol=1e-6, atol=1e-6)


def test_a_number_that_the_file_leaves_at_zero_has_the_derivative_zero():
    """A friction loss brakes by itself, -loss dt / m; compensation of gravity lifts by g dt of its share."""
    xml = """<mujoco><worldbody><body gravcomp="{0}"><joint type="slide" axis="0 0 1" frictionloss="{0}"/>
      <geom size=".1" mass="2"/></body></worldbody></mujoco>"""

    def function(step, number):
        model = put_model(mujoco.MjModel.from_xml_string(xml.format(number)))

        def speed(x):
            moved = model.replace(dof_frictionloss=number + x[:1], body_gravcomp=jnp.array([0, number + x[1]]))
            return step(moved, make_data(moved).replace(qvel=jnp.ones(1))).qvel[0]

        return speed

    zero, expected = jnp.zeros(2), (-0.002 / 2, 0.002 * 9.81)
    for step in (mjx.step, tog.step):
        np.testing.assert_array_equal(compile_quickly(jax.jacfwd(function(step, 0)))(zero), zero)
    found = compile_quickly(jax.grad(function(tog.step, 1e-6)))(zero)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_body_without_mass_has_a_derivative():
    """A pendulum, and a site's body whose subtree weighs nothing: stock MJX of today is right."""
    xml = """<mujoco><worldbody><body><site/></body><body><joint axis="0 1 0"/>
      <geom size=".05" pos="0 0 -.4" mass="2"/></body></worldbody></mujoco>"""
    angle, inertia = 0.7, 2 * 0.4**2 + 0.4 * 2 * 0.05**2
    expected = [[-0.002 * 2 * 9.81 * 0.4 * np.cos(angle) / inertia, 1]]
    for step in (mjx.step, tog.step):
        found = compile_quickly(jax.jacrev(velocity(step, xml)))(jnp.array([angle, 0.3]))
        np.testing.assert_allclose(found, expected, rtol=1e-9)


# A finger at a box, and another one that does not touch it.
FINGERS = """<mujoco><option gravity="0 0 0" cone="elliptic"/><worldbody>
  <body><joint type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="1" contype="0"/></body>
  <body pos="-.1998 0 0"><joint name="push" type="slide" axis="1 0 0"/>
    <geom size=".1" mass=".5" conaffinity="0"{solref}/></body>
  <body pos=".3 0 0"><joint type="slide" axis="1 0 0"/><geom size=".1" mass=".5" conaffinity="0"/></body></worldbody>
  <actuator><motor joint="push"/></actuator></mujoco>"""
FINGER = FINGERS.format(solref="")
PUSHED = np.array([0, 0, 0, 0.1, 0.4, 0, 2.0])


@pytest.fixture(scope="module")
def pushed() -> tuple[np.ndarray, np.ndarray]:
    """The derivative of the box's velocity in (qpos, qvel, ctrl), and in the solref [2] of the finger that pushes."""
    model = put_model(mujoco.MjModel.from_xml_string(FINGER))
    data = make_data(model)

    @compile_quickly
    @jax.grad
    def gradient(at):
        x, solref = at
        moved = model.replace(geom_solref=model.geom_solref.at[1].set(solref))
        state = data.replace(qpos=x[:3], qvel=x[3:6], ctrl=x[6:])
        return tog.step(moved, state).qvel[0]

    return gradient((jnp.array(PUSHED), jnp.array([0.02, 1.0])))


def test_a_finger_pushes_a_box(pushed):
    assert_no_reverse_mode(FINGER, PUSHED)
    np.testing.assert_allclose(pushed[0], slopes(lambda x: in_c(FINGER, x), PUSHED)[0], rtol=1e-6, atol=1e-6)
    assert pushed[0][6] > 1e-4  # The finger's control moves the box.


def test_a_sphere_hits_a_box(pushed):
    after = velocity(mjx.step, FINGER)
    stock = compile_quickly(lambda x: jax.jvp(after, (x,), (jnp.ones_like(x),))[1])(jnp.array(PUSHED))
    assert np.isnan(stock).any()

    def box(solref):
        given = ' solref="{} {}"'.format(*map(repr, map(float, solref)))
        return in_c(FINGERS.format(solref=given), PUSHED)[:1]

    expected = slopes(box, np.array([0.02, 1.0]))[0]
    assert abs(expected[1]) > 1e-4  # The damping ratio's.
    np.testing.assert_allclose(pushed[1], expected, rtol=1e-5)


def test_a_capsule_hits_a_sphere():
    xml = """<mujoco><option gravity="0 0 0"/><worldbody>
      <body pos="-.1998 0 0"><joint type="slide" axis="1 0 0"/><geom type="capsule" size=".1 .2" mass="3"/></body>
      <body><joint type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    x = np.array([0, 0, 0.8, 0])
    assert_no_reverse_mode(xml, x)
    found = compile_quickly(jax.jacrev(velocity(tog.step, xml)))(jnp.array(x))
    np.testing.assert_allclose(found, slopes(lambda x: in_c(xml, x), x), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.array([3, 1]) @ found, [0, 0, 3, 1], atol=1e-12)  # Nothing is lost.
    assert found[1, 2] > 0.1


def test_both_modes_agree_on_a_ball_in_the_air():
    """Where it is moves with where it was: stock MJX of today is right in reverse mode too."""
    xml = """<mujoco><option density="1.2" viscosity="2e-5"/><worldbody><body><joint type="slide" axis="0 0 1"/>
      <geom size=".1"/></body></worldbody></mujoco>"""
    model = put_model(mujoco.MjModel.from_xml_string(xml))

    def height(step, x):
        return step(model, make_data(model).replace(qpos=x, qvel=jnp.ones(1))).qpos

    @compile_quickly
    def derivatives(x):
        stock = (mode(lambda x: height(mjx.step, x))(x) for mode in (jax.jacfwd, jax.jacrev))
        return *stock, jax.jacrev(lambda x: height(tog.step, x))(x)

    np.testing.assert_allclose(derivatives(jnp.array([10.0])), np.ones((3, 1, 1)), rtol=1e-12)


def test_a_direct_solref_bounces_as_in_c():
    """A spring without a damper, of the floor alone: a step in it, on stock MJX and here."""
    xml = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="plane" size="1 1 1" solref="-1000 0"/>
      <body pos="0 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" condim="1"/></body></worldbody></mujoco>"""
    x = np.array([-0.01, -0.1])
    after, along = velocity(tog.step, xml), jnp.array([1.0, 0.0])
    stock = compile_quickly(velocity(mjx.step, xml))(jnp.array(x))
    value, slope = compile_quickly(lambda x: jax.jvp(after, (x,), (along,)))(jnp.array(x))
    expected = in_c(xml, x)
    assert expected > -0.1 + 0.01  # It is thrown back: no damper is in it.
    np.testing.assert_allclose([stock, value], [expected] * 2, rtol=1e-9)
    np.testing.assert_allclose(slope, slopes(lambda x: in_c(xml, x), x)[:, 0], rtol=1e-6)


def test_a_muscle_in_single_precision():
    xml = """<mujoco><worldbody><body><joint name="joint" type="slide"/><geom size=".1" mass="2"/></body></worldbody>
      <actuator><muscle joint="joint" lengthrange="-1 1" force="10"/></actuator></mujoco>"""
    tau = 0.01 * (0.5 + 1.5 * 0.2)
    expected = [0.002 / tau, 1 - 0.002 * (1 / tau + 0.5 * 1.5 * 0.01 / tau**2)]
    with jax.enable_x64(False):
        model = put_model(mujoco.MjModel.from_xml_string(xml))

        def activation(step, x):
            return step(model, make_data(model).replace(ctrl=x[:1], act=x[1:])).act[0]

        stock, ours = (
            compile_quickly(jax.grad(lambda x, s=step: activation(s, x)))(jnp.array([0.7, 0.2]))
            for step in (mjx.step, tog.step)
        )
    assert np.isnan(stock).all()
    np.testing.assert_allclose(ours, expected, rtol=1e-5)


def test_the_distance_before_a_touch():
    """A gap of 0.3 m less how far the ball moves, from a sensor that MJX refuses, through C MuJoCo."""
    xml = """<mujoco><worldbody><geom name="box" type="box" size=".1 .1 .1"/>
      <body pos="-.5 0 0"><joint type="slide" axis="1 0 0"/><geom name="ball" size=".1"/></body></worldbody>
      {}</mujoco>"""
    model = put_model(mujoco.MjModel.from_xml_string(xml.format("")))

    @compile_quickly
    def gap(moved):
        def of(x):
            return contacts(mjx.collision(model, mjx.kinematics(model, make_data(model).replace(qpos=x)))).distance[0]

        return jax.jvp(of, (moved,), (jnp.ones(1),))

    assert gap(jnp.zeros(1)) == (1, 0)
    sensor = '<sensor><distance name="gap" geom1="ball" geom2="box" cutoff="1"/></sensor>'
    problem = tog.Problem(
        mujoco.MjSpec.from_string(xml.format(sensor)),
        steps=1,
        variables=tog.Start("qpos"),
        cost=lambda last: last.sensor("gap")[0],
    )
    value, slope = jax.value_and_grad(tog.objective(problem, "mujoco"))(jnp.array([0.05]))
    np.testing.assert_allclose(value, 0.25, rtol=1e-9)
    np.testing.assert_allclose(slope, [-1], rtol=1e-6)


def test_a_cart_in_single_precision():
    """Where forces are small the line search divides by the square of a rounding error, whose inverse squared is
    beyond float32: a pole about its balance, between the limits of its cart."""
    xml = """<mujoco><option iterations="1" ls_iterations="4"/><default><geom contype="0"/></default><worldbody><body>
      <joint name="cart" type="slide" axis="1 0 0" range="-1.8 1.8"/><geom size=".1" mass="1"/><body>
      <joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 1" size=".045" mass=".1"/></body></body></worldbody>
      <actuator><motor joint="cart" gear="10"/></actuator></mujoco>"""
    generator = np.random.default_rng(0)
    states = generator.uniform(-1, 1, (64, 5)) * 10 ** generator.uniform(-9, 0, (64, 1))

    def derivatives(step):
        with jax.enable_x64(False):
            after = velocity(step, xml)
            return compile_quickly(jax.vmap(jax.jacfwd(after)))(jnp.array(states, jnp.float32))

    assert np.isnan(derivatives(mjx.step)).any()
    expected = [slopes(lambda x: in_c(xml, x), x, h=1e-5) for x in states]
    np.testing.assert_allclose(derivatives(tog.step), expected, rtol=0, atol=1e-5)


def test_a_spring_turns_a_ball_joint_at_rest():
    """By -k dt / I: the joint's frame is that of a sphere's centre."""
    xml = """<mujoco><worldbody><body><joint type="ball" stiffness="10"/><geom size=".1" mass="5"/></body></worldbody>
      </mujoco>"""
    model = put_model(mujoco.MjModel.from_xml_string(xml))

    def turning(step, rotation):
        quaternion = jnp.append(1.0, rotation / 2)
        return step(model, make_data(model).replace(qpos=quaternion / jnp.linalg.norm(quaternion))).qvel

    stock, ours = (
        compile_quickly(jax.jacfwd(lambda x, s=step: turning(s, x)))(jnp.zeros(3)) for step in (mjx.step, tog.step)
    )
    np.testing.assert_array_equal(stock, np.zeros((3, 3)))
    np.testing.assert_allclose(ours, -10 * 0.002 / (0.4 * 5 * 0.1**2) * np.eye(3), rtol=1e-9, atol=1e-12)
