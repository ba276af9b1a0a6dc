"""MJX is MuJoCo, and its gradient is the derivative of its value."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from conftest import cost_in_c, simulate_in_c
from jax.test_util import check_grads
from states import KINDS, draw_state

from tog_mjx.engines import MjxSimulator, make_simulator
from tog_mjx.engines.objective import final_cost, rollout
from tog_mjx.mjcf.scene import scene_path
from tog_mjx.paper.tasks import get_task
from tog_mjx.stepping import implicit
from tog_mjx.stepping._mjx import check_version, mjx

SCENE = get_task("grasp").scene
EPS = float(np.finfo(float).eps) ** (1 / 3)


def test_motion_is_that_of_c_mujoco(compiled):
    task = compiled.task
    motion = compiled.motions(make_simulator("mjx", task.scene), compiled.setpoints)
    found = np.concatenate([motion.box[..., :3], motion.fingers[..., :2].reshape(*motion.box.shape[:2], -1)], axis=-1)
    for i, u in enumerate(np.asarray(compiled.setpoints)[:16]):
        expected, _ = simulate_in_c(task, u)
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_the_solver_has_converged(name):
    task = get_task(name)
    # MuJoCo's models are edited in place: work on a copy.
    doubled = copy.copy(task.scene.model)
    doubled.opt.iterations *= 2
    doubled.opt.ls_iterations *= 2
    low, high = np.array(task.window).T
    for point in np.random.default_rng(5).uniform(low, high, (16, 2)):
        u = np.asarray(task.expand(jnp.array(point)))
        np.testing.assert_allclose(simulate_in_c(task, u)[0], simulate_in_c(task, u, doubled)[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize("compiled", ["grasp"], indirect=True)
def test_mjxs_solver_has_converged_too(compiled):
    simulator = make_simulator("mjx", compiled.task.scene)
    assert isinstance(simulator, MjxSimulator)
    option = simulator.model.opt
    more = option.replace(iterations=2 * option.iterations, ls_iterations=2 * option.ls_iterations)
    doubled = dataclasses.replace(simulator, model=simulator.model.replace(opt=more))
    once, twice = (compiled.motions(some, compiled.setpoints).box for some in (simulator, doubled))
    np.testing.assert_allclose(twice, once, rtol=0, atol=1e-10)


@pytest.fixture(scope="module")
def one_step():
    """(qpos, qvel, setpoints) -> (qpos, qvel) of the grasp, compiled."""
    simulator = make_simulator("mjx", SCENE)
    assert isinstance(simulator, MjxSimulator)

    @jax.jit
    def step(qpos, qvel, setpoints):
        state = simulator.step(simulator.init(*SCENE.start) | {"qpos": qpos, "qvel": qvel}, setpoints)
        return state["qpos"], state["qvel"]

    return lambda *args: step(*map(jnp.asarray, args))


@pytest.mark.parametrize("kind", KINDS)
def test_one_step_is_differentiated_right_in_both_modes(one_step, kind):
    box, fingers = draw_state(kind, SCENE.physics, 7)
    qpos = np.concatenate([box[:3], fingers[:, :2].ravel()])
    qvel = np.concatenate([box[3:], fingers[:, 2:].ravel()])
    args = (jnp.array(qpos), jnp.array(qvel), jnp.array([-0.1, 0.3, 0.2, 0.4]))
    check_grads(one_step, args, order=1, modes=["fwd", "rev"], eps=EPS, rtol=1e-6, atol=1e-6)


def test_zero_sliding_speed_has_a_finite_gradient(one_step):
    box, fingers = draw_state("sticking", SCENE.physics, 7)
    qpos = jnp.array(np.concatenate([box[:3], fingers[:, :2].ravel()]))
    _, pull = jax.vjp(one_step, qpos, jnp.zeros(7), jnp.zeros(4))
    jacobian = np.array([pull((jnp.zeros(7), row))[1] for row in jnp.eye(7)])
    assert np.isfinite(jacobian).all()
    # Viscous friction on the standing corner, b_f dt / m, to first order slows the box along the floor.
    assert 0 < 1 - jacobian[0, 0] < 0.2


def test_the_horizons_gradient_is_that_of_c_mujocos_differences(compiled):
    task = compiled.task
    gradients = compiled.gradients(make_simulator("mjx", task.scene), compiled.setpoints)
    assert np.isfinite(gradients).all()
    h = 1e-8
    for u, gradient in zip(np.asarray(compiled.setpoints)[:8], np.asarray(gradients), strict=False):
        steps = h * np.eye(u.size)
        difference = np.array([cost_in_c(task, u + d) - cost_in_c(task, u - d) for d in steps]) / (2 * h)
        np.testing.assert_allclose(gradient, difference, rtol=1e-4, atol=1e-6 * (1 + np.abs(difference).max()))


@pytest.fixture(scope="module")
def flip_simulators():
    scene = get_task("flip").scene
    return {d: make_simulator("mjx", scene, differentiation=d) for d in ("implicit", "native")}


def test_reverse_mode_agrees_with_forward_mode(flip_simulators):
    task = get_task("flip")

    @jax.jit
    def both_modes(u):
        _, push = jax.linearize(lambda u: final_cost(task, flip_simulators["implicit"], u), u)
        return jax.vmap(push)(jnp.eye(u.size)), jax.linear_transpose(push, u)(1.0)[0]

    forward, reverse = both_modes(jnp.array(task.initial_guess))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)


def test_the_mode_of_differentiation_changes_no_value(flip_simulators):
    task = get_task("flip")
    u = jnp.array(task.initial_guess)

    def cost(differentiation):  # Optimised: without, LLVM rounds equal programs differently.
        simulator = flip_simulators[differentiation]
        options = {"xla_backend_optimization_level": 3}
        return jax.jit(lambda u: final_cost(task, simulator, u), compiler_options=options)

    along, _ = jax.jvp(cost("implicit"), (u,), (jnp.ones(2),))
    assert cost("native")(u) == cost("implicit")(u) == along


def test_what_implicit_differentiation_mends():
    xml = """<mujoco><option cone="elliptic"/><worldbody><geom type="plane" size="1 1 1"/>
      <body pos="0 0 0.09"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><geom size="0.1"/></body>
      <body pos="1 0 2"><joint type="slide" axis="0 0 1"/><geom size="0.1"/></body></worldbody></mujoco>"""
    model = mjx.put_model(mujoco.MjModel.from_xml_string(xml))
    data = mjx.make_data(model)

    def slide(step, qvel):
        return step(model, data.replace(qvel=qvel)).qvel[0]

    # One ball slides; the other is in the air, a contact without a force.
    at = jnp.array([0.5, 0.0, 0.0])
    with pytest.raises(ValueError, match="Reverse-mode differentiation does not work"):
        jax.jit(jax.grad(lambda qvel: slide(mjx.step, qvel)))(at)
    assert np.isnan(jax.jit(jax.jacfwd(lambda qvel: slide(mjx.step, qvel)))(at)).any()
    ours = jax.jit(jax.grad(lambda qvel: slide(implicit.step, qvel)))(at)
    value = jax.jit(lambda qvel: slide(mjx.step, qvel))
    difference = [(value(at + d) - value(at - d)) / (2 * EPS) for d in EPS * np.eye(3)]
    np.testing.assert_allclose(ours, difference, rtol=1e-7)


def test_step_is_a_drop_in_for_mjx_step():
    model = mjx.put_model(SCENE.model)
    box, fingers = draw_state("sliding", SCENE.physics, 9)
    data = mjx.make_data(model).replace(
        qpos=jnp.concatenate([box[:3], fingers[:, :2].ravel()]),
        qvel=jnp.concatenate([box[3:], fingers[:, 2:].ravel()]),
        ctrl=jnp.array([-0.1, 0.3, 0.2, 0.4]),
    )
    ours, theirs = jax.jit(implicit.step)(model, data), jax.jit(mjx.step)(model, data)
    found, expected = map(jax.tree_util.tree_leaves_with_path, (ours, theirs))
    for (path, leaf), (same_path, other) in zip(found, expected, strict=True):
        assert path == same_path
        np.testing.assert_array_equal(leaf, other, err_msg=jax.tree_util.keystr(path))


def test_a_simulator_made_under_another_precision_is_told():
    scene = get_task("flip").scene
    with jax.enable_x64(False):
        simulator = make_simulator("mjx", scene)
    with pytest.raises(ValueError, match="x64 flag changed"):
        simulator.init(*scene.start)


def test_actuators_keep_their_activation(tmp_path):
    # A servo behind a low-pass filter: its state is part of the motion.
    spec = mujoco.MjSpec.from_file(str(scene_path("flip")))
    for actuator in spec.actuators:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
        actuator.dynprm[0] = 0.05
    path = tmp_path / "filtered.xml"
    path.write_text(spec.to_xml())
    task = dataclasses.replace(get_task("flip"), model=path, steps=99)
    u = np.array([0.1, 0.4])
    motion = rollout(task, u, "mjx")
    expected, _ = simulate_in_c(task, u)
    np.testing.assert_allclose(motion.box[:, :3], expected[:, :3], rtol=0, atol=1e-9)
    assert np.abs(motion.box[-1, :3] - rollout("flip", u, "mjx").box[99, :3]).max() > 1e-3


def test_the_cost_jumps_where_a_touch_moves_to_another_time_step():
    # At the paper's own initial guess a difference of 1e-7 m sees the derivative, one of 1e-6 m a jump.
    task = get_task("flip")
    u = task.initial_guess

    def difference(h):
        step = np.array([h, 0])
        return (cost_in_c(task, u + step) - cost_in_c(task, u - step)) / (2 * h)

    np.testing.assert_allclose(difference(1e-7), difference(1e-8), rtol=1e-5)
    assert abs(difference(1e-6) - difference(1e-7)) > 10


def test_a_model_of_another_implementation_is_refused():
    model = mjx.put_model(SCENE.model, impl="cpp")
    with pytest.raises(ValueError, match=r"on MJX's cpp implementation.*impl=\"jax\""):
        implicit.step(model, mjx.make_data(mjx.put_model(SCENE.model)))


@pytest.mark.parametrize("version", ["3.16.4", "4.0.0", "2.3"])
def test_another_version_of_mjx_fails_loudly(version):
    with pytest.raises(ImportError, match=rf"mujoco-mjx {version} is installed, tog_mjx needs >=3\.17,<4\.0"):
        check_version(version)
