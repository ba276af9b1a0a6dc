"""C MuJoCo as an engine: its motions are those of a loop over `mj_step`, and its gradients are held against MJX's,
closed forms and differences of whole motions."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from c_mujoco_scenes import FLOOR, PLANAR, STEPS, bodies, by_hand, differences, floor, in_both_modes, somewhere, speeds

import tog_mjx as tog


@pytest.fixture(scope="module", name="bodies")
def _bodies() -> tog.Problem:
    return bodies()


@pytest.fixture(scope="module")
def x(bodies) -> np.ndarray:
    return somewhere(bodies)


def test_a_motion_is_that_of_a_loop_over_mj_step(bodies, x):
    motion = tog.rollout(bodies, x, "mujoco")
    start = {"qpos": motion.qpos[0], "qvel": motion.qvel[0], "act": x[-1:]}
    data = by_hand(bodies, start, lambda _, step: motion.ctrl[step])
    np.testing.assert_allclose(motion.qpos[-1], data.qpos, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(motion.qvel[-1], data.qvel, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(motion.time, np.arange(STEPS + 1) * 0.01, rtol=1e-12)
    turned = bodies.origin.qpos.copy()
    mujoco.mj_integratePos(bodies.scene.model, turned, x[6 : 6 + bodies.scene.model.nv], 1.0)
    np.testing.assert_allclose(start["qpos"], turned, rtol=1e-12, atol=1e-15)
    states = list(zip(motion.qpos, motion.qvel, motion.ctrl, motion.time, strict=True))
    running = np.mean([qvel @ qvel + ctrl @ ctrl * time for _, qvel, ctrl, time in states[:-1]])
    last = ((data.qpos - 0.3) ** 2).sum() + data.qvel @ np.arange(len(data.qvel)) + data.act.sum()
    np.testing.assert_allclose(tog.objective(bodies, "mujoco")(x), last + running, rtol=1e-12)


def test_what_a_first_gradient_compiles_is_the_cost_and_its_transpose(caplog):
    """No key where no start is drawn, and no mean apart: each small function takes as long as many steps."""
    J = tog.objective(floor(steps=2), "mujoco")
    x = jnp.asarray(J.problem.x0)
    with jax.log_compiles():
        jax.grad(J)(x)
    compiled = re.findall(r"^Compiling jit\((\w+)\)", "\n".join(caplog.messages), re.MULTILINE)
    assert compiled.count("_mean") == 2
    assert set(compiled) <= {"_mean", "convert_element_type"}


def test_gradients_are_the_slopes_of_whole_motions_whatever_turns(bodies, x):
    """In controls, positions in velocity space, velocities and activations; bodies turn by a radian."""
    J = tog.objective(bodies, "mujoco")
    expected = differences(J, x)
    assert np.abs(expected).min() > 1e-4  # Each variable counts.
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-7)
    with_checkpoints = jax.grad(tog.objective(bodies, "mujoco", checkpoint=5))(jnp.asarray(x))
    np.testing.assert_allclose(with_checkpoints, jax.grad(J)(jnp.asarray(x)), rtol=1e-12, atol=1e-12)


def test_a_closed_loop_is_that_of_a_loop_over_mj_step_and_has_its_slope():
    """A control is held for three of twenty steps; with a constant one beside it."""

    def apply(gains, observed):
        return jnp.tanh(gains["w"] @ observed + gains["b"])

    gains = {"w": np.random.default_rng(1).normal(size=(2, 6)) * 0.3, "b": np.array([0.1, -0.2])}
    policy = tog.Policy(apply, gains, every=3)
    problem = floor(variables=[policy, tog.Controls()], running_cost=speeds)
    J, x = tog.objective(problem, "mujoco"), problem.x0 + 0.05
    tree = {"b": x[:2], "w": x[2:14].reshape(2, 6)}

    def controls(data, step):
        if step % 3:
            return data.ctrl.copy()
        return np.tanh(tree["w"] @ np.concatenate([data.qpos, data.qvel]) + tree["b"]) + x[14:]

    motion, data = tog.rollout(problem, x, "mujoco"), by_hand(problem, {}, controls)
    np.testing.assert_allclose(motion.qpos[-1], data.qpos, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(motion.qvel[-1], data.qvel, rtol=1e-12, atol=1e-12)
    expected = differences(J, x, 1e-4)
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-7)


def test_on_one_smooth_piece_of_a_contact_the_gradient_is_that_of_mjx():
    problem = floor('cone="elliptic" tolerance="1e-12"')
    x = np.array([0.5, 0.2, -0.7, -0.4])
    (value, expected), (found, gradient) = (
        jax.jit(jax.value_and_grad(tog.objective(problem, engine)))(x) for engine in ("mjx", "mujoco")
    )
    np.testing.assert_allclose(found, value, rtol=1e-9)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_a_model_that_mjx_refuses_has_values_and_gradients():
    """The solver PGS, and the energy beside."""
    problem = floor('solver="PGS" tolerance="1e-12" iterations="200"', more='<camera name="some"/>')
    problem.scene.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    with pytest.raises(tog.InputError, match="MJX does not support"):
        tog.objective(problem, "mjx")
    J, x = tog.objective(problem, "mujoco"), np.array([0.5, 0.2, -0.7, -0.4])
    data = by_hand(problem, {}, lambda _, step: x[:2] + (x[2:] - x[:2]) * step / (STEPS - 1))
    np.testing.assert_allclose(tog.rollout(problem, x, "mujoco").qpos[-1], data.qpos, rtol=1e-12, atol=1e-14)
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, differences(J, x, 1e-4), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("height", [0.1, 0.1 + 3e-7])
def test_a_difference_that_crosses_a_touch_is_not_taken(height):
    """A ball that falls at the floor's height, or just above it, falls on for one step: z = z_0 + v_0 t without
    gravity. Lower by as much as a difference is long it would be held, by a damper that begins at once."""
    variables = [tog.Start("qpos[1]"), tog.Start("qvel[1]")]
    problem = floor('gravity="0 0 0"', steps=1, variables=variables, cost=lambda last: last.qpos[1])
    problem.scene.model.geom_solref[:] = -2000, -100
    for gradient in in_both_modes(tog.objective(problem, "mujoco"), np.array([height - 0.099, -0.2])):
        np.testing.assert_allclose(gradient, [1, 0.005], rtol=1e-7)


COUPLED = """
<mujoco>
  <option timestep="0.01" integrator="{integrator}" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="a" type="slide" axis="1 0 0"/><geom size="0.1" mass="100"/></body>
    <body pos="0 1 0"><joint name="b" type="slide" axis="1 0 0"/><geom size="0.1" mass="100"/></body>
  </worldbody>
  <equality><joint joint1="a" joint2="b"/></equality>
  <actuator><motor joint="a"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("output", [lambda last: last.qpos[0], lambda last: last.qacc[1]])
def test_a_solver_at_its_answer_answers_to_a_difference(integrator, output):
    """Two masses joined, at rest: a force of 1e-6 N on one is less than the solver's tolerance. All is linear."""
    model = mujoco.MjModel.from_xml_string(COUPLED.format(integrator=integrator))
    J = tog.objective(tog.Problem(model, STEPS, cost=output), "mujoco")
    expected = float(J(np.ones(1)) - J(-np.ones(1))) / 2
    assert abs(expected) > 1e-5
    for gradient in in_both_modes(J, np.zeros(1)):
        np.testing.assert_allclose(gradient, expected, rtol=1e-4)


SEESAW = """
<mujoco>
  <option timestep="0.005" gravity="0 0 0" tolerance="1e-14"/>
  <worldbody><geom type="plane" size="5 5 0.1" solref="{law}"/>
    <body pos="0 0 0.1"><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
      <geom size="0.1" pos="1 0 0" mass="1" solref="{law}"/>
      <geom size="0.1" pos="{left} 0 0" mass="1" solref="{law}"/></body>
  </worldbody>
</mujoco>"""


@pytest.mark.parametrize(
    ("law", "left", "speed"),
    [
        ("-2000 -100", -1, -0.2),  # It falls, with both ends at the floor: tilted either way, one is held at once.
        ("-2000 -1", -0.5, 0.0),  # It stands: tilted, one end or the other is pressed the more the farther.
    ],
)
def test_where_it_jumps_or_bends_to_both_sides_the_slope_is_that_beyond_and_the_mean(law, left, speed):
    model = mujoco.MjModel.from_xml_string(SEESAW.format(law=law, left=left))

    def after(tilt: float) -> float:
        data = mujoco.MjData(model)
        data.qpos[1], data.qvel[0] = tilt, speed
        mujoco.mj_step(model, data)
        return float(data.qpos[1])

    sides = [(after(sign * 2e-6) - after(sign * 1e-6)) / (sign * 1e-6) for sign in (1, -1)]
    jump = np.abs(after(1e-9) - after(-1e-9))
    assert (jump > 1e-4) == (speed != 0)
    assert (abs(sides[0] - sides[1]) > 5e-3) == (speed == 0)
    start = mujoco.MjData(model)
    start.qvel[0] = speed
    problem = tog.Problem(model, 1, tog.Start("qpos[1]"), cost=lambda last: last.qpos[1], start=start)
    for gradient in in_both_modes(tog.objective(problem, "mujoco"), np.zeros(1)):
        np.testing.assert_allclose(gradient, np.mean(sides), rtol=1e-5)


@pytest.mark.parametrize(
    ("of", "message"),
    [
        ({"cost": lambda last: last.data.qacc.sum()}, "no mjx.Data.* engine mjx"),
    ],
)
def test_what_it_cannot_do_is_one_line(of, message):
    problem = floor(**of)
    with pytest.raises(tog.InputError, match=message) as caught:
        jax.grad(tog.objective(problem, "mujoco"))(jnp.asarray(problem.x0))
    assert "\n" not in str(caught.value)


def test_options_second_derivatives_and_hidden_states_are_one_line():
    with pytest.raises(tog.InputError, match="'mujoco' has no option 'friction'"):
        tog.objective("flip", "mujoco", friction="paper")
    with pytest.raises(tog.InputError, match="differentiation='native' is unknown; choose from implicit, saltation"):
        tog.objective("flip", "mujoco", differentiation="native")
    with pytest.raises(tog.InputError, match="first derivatives only"):
        jax.hessian(tog.objective(floor(), "mujoco"))(jnp.zeros(4))
    with pytest.raises(tog.InputError, match="'mujoco' is unknown; choose from mjx, penalty"):
        tog.make_simulator("mujoco", tog.load_scene("flip"))
    problem = floor()
    delayed = mujoco.MjSpec.from_string(FLOOR.format(options="", joints=PLANAR, more=""))
    delayed.actuators[0].delay, delayed.actuators[0].nsample = 0.02, 5
    with pytest.raises(tog.InputError, match="no state for delays"):
        tog.objective(dataclasses.replace(problem, model=delayed.compile()), "mujoco")


@pytest.mark.parametrize("checkpoint", [None, 5])
def test_a_scene_without_actuators_falls_as_it_was_thrown(checkpoint):
    """z = z0 + v T - g T (T + h) / 2 after semi-implicit steps of h: the slope in the speed is T."""
    text = (
        '<mujoco><option timestep="0.01"/><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    problem = tog.Problem(model, STEPS, tog.Start("qvel"), cost=lambda last: last.qpos[2])
    J = tog.objective(problem, "mujoco", checkpoint=checkpoint)
    for gradient in in_both_modes(J, problem.x0 + 0.5):
        np.testing.assert_allclose(gradient, [0, 0, STEPS * 0.01, 0, 0, 0], atol=1e-8)
