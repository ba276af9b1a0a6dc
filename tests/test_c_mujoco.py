"""C MuJoCo as an engine: its motions are those of a loop over `mj_step`, and its gradients are held against MJX's,
closed forms and differences of whole motions."""

import dataclasses
import subprocess
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.running.quiet import without_warnings
from tog_mjx.stepping.mjx_state import copy_of

# A free body that turns, a ball joint on a hinge, and an actuator with an activation; nothing touches.
BODIES = """
<mujoco model="bodies">
  <option timestep="0.01" integrator="{integrator}"/>
  <worldbody>
    <body name="free" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="1"/>
      <site name="tip" pos="0.1 0 0.3"/></body>
    <body pos="2 0 1"><joint name="hinge" axis="0 1 0" damping="0.1"/><geom size="0.05" pos="0.3 0 0" mass="0.5"/>
      <body pos="0.6 0 0"><joint type="ball" stiffness="2" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.04" mass="0.3"/></body></body>
  </worldbody>
  <actuator>
    <motor site="tip" gear="1 0.5 0 0 0.3 0.2"/>
    <general joint="hinge" dyntype="filter" dynprm="0.05" gainprm="2"/>
  </actuator>
</mujoco>"""
# A ball that rolls on a floor, pressed into it, and pushed; `{options}` of the solver.
FLOOR = """
<mujoco model="floor">
  <option timestep="0.005" {options}/>
  <worldbody><geom type="plane" size="5 5 0.1" solref="0.05 1"/>
    <body pos="0 0 0.099">{joints}<geom size="0.1" mass="1" solref="0.05 1"/></body>
    {more}
  </worldbody>
  <actuator><motor joint="x"/><motor joint="z"/></actuator>
</mujoco>"""
PLANAR = """<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="roll" axis="0 1 0"/>"""
STEPS = 20


def distance(last: tog.State) -> jax.Array:
    return jnp.sum((last.qpos - 0.3) ** 2) + jnp.sum(last.qvel * jnp.arange(last.qvel.size)) + last.act.sum()


def speeds(state: tog.State) -> jax.Array:
    return state.qvel @ state.qvel + state.ctrl @ state.ctrl * state.time


@pytest.fixture(scope="module")
def bodies() -> tog.Problem:
    model = mujoco.MjModel.from_xml_string(BODIES.format(integrator="implicitfast"))
    kinds = [tog.Controls(knots=3), tog.Start("qpos"), tog.Start("qvel"), tog.Start("act")]
    return tog.Problem(model, STEPS, kinds, cost=distance, running_cost=speeds)


@pytest.fixture(scope="module")
def x(bodies) -> np.ndarray:
    return np.random.default_rng(0).normal(size=len(bodies.x0)) * 0.5


def floor(options: str = "", joints: str = PLANAR, more: str = "", **of) -> tog.Problem:
    model = mujoco.MjModel.from_xml_string(FLOOR.format(options=options, joints=joints, more=more))
    return tog.Problem(model, **{"steps": STEPS, "variables": tog.Controls(2), "cost": distance, **of})


def by_hand(problem: tog.Problem, start: dict, controls) -> mujoco.MjData:
    """The data after a loop over `mj_step` under `controls(data, step)`."""
    data = copy_of(problem.scene.model, problem.origin, **start)
    for step in range(problem.steps):
        data.ctrl[:] = controls(data, step)
        mujoco.mj_step(problem.scene.model, data)
    return data


def differences(J, x: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """The gradient, by central differences of whole motions, all at once."""
    ahead, behind = (jax.vmap(J)(jnp.asarray(x + sign * step * np.eye(len(x)))) for sign in (1, -1))
    return np.asarray(ahead - behind) / (2 * step)


def in_both_modes(J, x) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(jax.jit(jax.grad(J))(jnp.asarray(x))), np.asarray(jax.jit(jax.jacfwd(J))(jnp.asarray(x)))


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
        np.testing.assert_allclose(gradient, differences(J, x, 1e-4), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("height", [0.1, 0.1 + 3e-7])
def test_a_difference_that_crosses_a_touch_is_not_taken(height):
    """A ball that falls at the floor's height, or just above it, falls on for one step: z = z_0 + v_0 t without
    gravity. Lower by as much as a difference is long it would be held, by a damper that begins at once."""
    variables = [tog.Start("qpos[1]"), tog.Start("qvel[1]")]
    problem = floor('gravity="0 0 0"', steps=1, variables=variables, cost=lambda last: last.qpos[1])
    problem.scene.model.geom_solref[:] = -2000, -100
    for gradient in in_both_modes(tog.objective(problem, "mujoco"), np.array([height - 0.099, -0.2])):
        np.testing.assert_allclose(gradient, [1, 0.005], rtol=1e-7)


def test_many_motions_are_those_of_one_and_no_call_leaves_anything_to_the_next(bodies, x):
    """To the bit, also after a motion that burst, and for any number of threads."""
    points = jnp.asarray(x + np.random.default_rng(2).normal(size=(5, len(x))) * 0.3)

    def ends(x):
        motion = tog.rollout(bodies, x, "mujoco")
        return jnp.concatenate([motion.qpos[-1], motion.qvel[-1]])

    together, slopes_together = jax.vmap(ends)(points), jax.vmap(jax.jacfwd(ends))(points)
    with without_warnings():
        assert np.isnan(ends(points[0] * 1e8)).all()
    one_by_one = [ends(point) for point in points]
    np.testing.assert_array_equal(together, one_by_one)
    assert len({row.tobytes() for row in np.asarray(together)}) == len(points)
    for point, slope in zip(points, slopes_together, strict=True):
        # The last bit of a start, which is computed otherwise for many, divided by the step of a difference.
        np.testing.assert_allclose(jax.jacfwd(ends)(point), slope, atol=1e-8)


def test_neither_the_number_of_threads_nor_what_ran_before_changes_a_bit(bodies):
    """Of motions and their derivatives, some of which burst."""
    model, rng = bodies.scene.model, np.random.default_rng(3)
    forwards = [Forward(model, bodies.origin, threads) for threads in (1, 3)]
    many = rng.normal(size=(7, STEPS, 2)), np.tile(forwards[0].start, (7, 1))
    many[1][:, 1 + model.nq :] += rng.normal(size=(7, forwards[0].start.size - 1 - model.nq))
    many[1][3, 1 + model.nq] = 1e12

    def run(forward: Forward, some: slice) -> list[np.ndarray]:
        controls, start = (part[some] for part in many)
        after = forward.motions(start, controls)
        before = np.concatenate([start[:, None], after[:, :-1]], axis=1)
        rows = (part.reshape(-1, part.shape[-1]) for part in (before, after, controls))
        return [after, *(part.reshape(len(start), STEPS, *part.shape[1:]) for part in slopes(forward, *rows))]

    with without_warnings():
        expected = run(forwards[0], slice(None))
        assert [np.isnan(motion).any() for motion in expected[0]] == [i == 3 for i in range(7)]
        for forward in forwards:
            for some in (slice(2, 4), slice(None), slice(4, 5)):
                for found, of_all in zip(run(forward, some), expected, strict=True):
                    np.testing.assert_array_equal(found, of_all[some])


def test_starts_descents_landscapes_and_single_precision():
    def sample(key):
        return {"qvel": jax.random.normal(key, [3]) * 0.1}

    problem = floor(start=tog.Starts(sample, 4), variables=tog.Controls())
    J, key, x = tog.objective(problem, "mujoco"), jax.random.key(1), jnp.array([0.3, -0.1])
    costs = J.each(x, key)
    motions = J.motion(x, key)
    for cost, qpos, qvel in zip(costs, motions.qpos, motions.qvel, strict=True):
        data = by_hand(problem, {"qvel": qvel[0]}, lambda *_: np.asarray(x))
        np.testing.assert_allclose(qpos[-1], data.qpos, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(cost, ((data.qpos - 0.3) ** 2).sum() + data.qvel @ np.arange(3), rtol=1e-12)
    single = dataclasses.replace(problem, start=None)
    J = tog.objective(single, "mujoco")
    found = tog.solve(single, engine="mujoco", budget=400)
    assert J(found.best) < J(single.x0) - 0.1
    seen = tog.landscape(single, "mujoco", size=3)
    np.testing.assert_allclose(seen.costs.ravel(), [J(point) for point in seen.points], rtol=1e-12)
    expected = jax.grad(J)(x)
    with jax.enable_x64(False):
        gradient = jax.grad(tog.objective(single, "mujoco"))(jnp.asarray(np.asarray(x), jnp.float32))
    assert gradient.dtype == jnp.float32
    np.testing.assert_allclose(gradient, expected, rtol=1e-3)


def test_float64_of_one_thread_is_enough(x, bodies):
    """As `tog.solve("flip")` and landscapes have it: a callback runs in another thread."""
    J = tog.objective(bodies, "mujoco")
    expected = jax.grad(J)(jnp.asarray(x))
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            gradient = jax.jit(jax.grad(J))(jnp.asarray(x))
    finally:
        jax.config.update("jax_enable_x64", True)
    assert gradient.dtype == jnp.float64
    np.testing.assert_allclose(gradient, expected, atol=1e-7)


DEVICES = """
import os, jax, numpy as np
jax.config.update("jax_num_cpu_devices", os.cpu_count())
import tog_mjx as tog
from tog_mjx.running.devices import over_devices
flip = tog.get_task("flip")
with jax.enable_x64(True):
    points = np.tile(flip.x0, (8 * jax.device_count(), 1))
    slopes = over_devices(jax.vmap(jax.grad(tog.objective(flip, "mujoco"))))(points)
assert np.ptp(slopes, axis=0).max() < 1e-9 * np.abs(slopes).max()
"""


def test_all_devices_at_once_wait_for_none():
    """Each core a device, and each in a callback with arguments that JAX would copy on a thread of its own."""
    subprocess.run([sys.executable, "-c", DEVICES], check=True, timeout=100)


def test_where_bodies_and_sites_are_is_known_as_far_as_mjx_knows_it(bodies, x):
    problem = dataclasses.replace(bodies, cost=lambda last: last.site("tip") @ jnp.arange(3.0), running_cost=None)
    J = tog.objective(problem, "mujoco")
    motion = tog.rollout(problem, x, "mujoco")
    data = copy_of(problem.scene.model, problem.origin, qpos=motion.qpos[-1])
    mujoco.mj_kinematics(problem.scene.model, data)
    np.testing.assert_allclose(J(x), data.site("tip").xpos @ np.arange(3), rtol=1e-12)


MOCAP = '<body name="hand" mocap="true" pos="1 1 1"/>'


@pytest.mark.parametrize(
    ("of", "message"),
    [
        ({"variables": tog.Parameters("body_mass[1]")}, "engine mujoco .* variables move none; take mjx"),
        ({"variables": tog.Start("mocap_pos"), "more": MOCAP}, "moves qpos, qvel and act .* take mjx"),
        ({"cost": lambda last: last.data.qacc.sum()}, "no mjx.Data.* engine mjx"),
        ({"cost": lambda last: last.body("hand")[0], "more": MOCAP, "options": 'solver="PGS"'}, "MJX does not support"),
        ({"options": 'integrator="RK4"'}, "no derivative of .*RK4.* or take engine mjx"),
    ],
)
def test_what_it_cannot_do_is_one_line(of, message):
    problem = floor(**of)
    with pytest.raises(tog.InputError, match=message) as caught:
        jax.grad(tog.objective(problem, "mujoco"))(jnp.asarray(problem.x0))
    assert "\n" not in str(caught.value)


def test_options_second_derivatives_and_hidden_states_are_one_line():
    with pytest.raises(tog.InputError, match="'mujoco' has no option 'differentiation'"):
        tog.objective("flip", "mujoco", differentiation="implicit")
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
    text = '<mujoco><option timestep="0.01"/><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    problem = tog.Problem(model, STEPS, tog.Start("qvel"), cost=lambda last: last.qpos[2])
    J = tog.objective(problem, "mujoco", checkpoint=checkpoint)
    for gradient in in_both_modes(J, problem.x0 + 0.5):
        np.testing.assert_allclose(gradient, [0, 0, STEPS * 0.01, 0, 0, 0], atol=1e-8)
