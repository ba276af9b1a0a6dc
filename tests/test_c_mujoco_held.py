"""What is held during a motion of C MuJoCo: numbers of the model, mocap bodies, and fields that differ by start. Values
are those of a loop over `mj_step`; gradients are held against MJX's, closed forms and differences of whole motions."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from c_mujoco_scenes import BODIES, FLOOR, PLANAR, distance, in_both_modes, speeds

import tog_mjx as tog
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.mjcf.fields import assign, attribute
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.running.digests import function_digest, lowered
from tog_mjx.stepping.mjx_state import copy_of

# A ball that slides and rolls on a floor, and a load of two balls that slips off the ball in a mocap body's hand.
HELD = """
<mujoco model="held">
  <option timestep="0.005" cone="elliptic" tolerance="1e-14" {options}/>
  <default><geom solref="0.05 1" friction="0.3 0.01 0.001"/></default>
  <worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="ball" pos="0 0 0.09"><freejoint/><geom size="0.1" mass="1"/></body>
    <body name="hand" mocap="true" pos="1 0.1 1" quat="0.8 0 0.6 0"><geom size="0.05" pos="0.1 0.02 0"/>
      <site name="tip" pos="0.2 0 0"/></body>
    <body name="load" pos="1.03 0.12 1.05"><freejoint/><geom size="0.1" density="200"/>
      <geom size="0.05" pos="0.02 0.05 0.2" density="200" contype="0" conaffinity="0"/></body>
  </worldbody>
</mujoco>"""
STEPS = 15
NUMBERS = ("geom_friction[0, 0]", "body_mass[1]", "body_mass[3]", "geom_size[4, 0]", "opt.timestep", "opt.gravity")


def ends(last: tog.State) -> jax.Array:
    weights = jnp.cos(jnp.arange(last.qpos.size)), jnp.sin(1 + jnp.arange(last.qvel.size))
    return last.qpos @ weights[0] + last.qvel @ weights[1] + last.time**2


def held(options: str = "", **of) -> tog.Problem:
    spec = mujoco.MjSpec.from_string(HELD.format(options=options))
    model = spec.compile()
    start = mujoco.MjData(model)
    start.qvel[:6] = 1, 0.3, 0, 0.5, -0.2, 0.4
    kinds = [tog.Parameters(*NUMBERS), tog.Start("mocap_pos"), tog.Start("mocap_quat")]
    return tog.Problem(spec, **{"steps": STEPS, "variables": kinds, "cost": ends, "start": start, **of})


@pytest.fixture(scope="module")
def problem() -> tog.Problem:
    return held()


@pytest.fixture(scope="module")
def x(problem) -> np.ndarray:
    return problem.x0 + 0.02 * np.random.default_rng(0).normal(size=len(problem.x0)) * problem.bound.scale


def differences(J, problem: tog.Problem, x: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """The gradient, by central differences of whole motions, each as long as its variable is large."""
    steps = step * problem.bound.scale
    ahead, behind = (jax.vmap(J)(jnp.asarray(x + sign * np.diag(steps))) for sign in (1, -1))
    return np.asarray(ahead - behind) / (2 * steps)


def placed(problem: tog.Problem, x: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model and the start, by other means than the engine's: each number's `in_c` in turn, and quaternions."""
    spec, numbers = problem.model, dict(zip(problem.bound.names, x, strict=True))
    model = copy.copy(problem.scene.model)
    for name in NUMBERS:
        parameter = tog.Parameter(spec, name)
        alone = parameter.in_c(np.array([numbers[one] for one in parameter.names]))
        for array in parameter.arrays:
            new, base = attribute(alone, array), attribute(parameter.model, array)
            assign(model, array, np.asarray(attribute(model, array) + (new - base)))
    pos, turn = (np.array([numbers[f"{name}[0, {i}]"] for i in range(3)]) for name in ("mocap_pos", "mocap_quat"))
    quat = problem.origin.mocap_quat[0] / np.linalg.norm(problem.origin.mocap_quat[0])
    mujoco.mju_quatIntegrate(quat, turn, 1.0)
    return model, copy_of(model, problem.origin, mocap_pos=pos[None], mocap_quat=quat[None])


def test_a_motion_is_that_of_a_model_and_of_mocap_bodies_that_have_moved(problem, x):
    motion, (model, data) = tog.rollout(problem, x, "mujoco"), placed(problem, x)
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    still = tog.rollout(problem, problem.x0, "mujoco")
    assert np.abs(data.qpos - still.qpos[-1]).max() > 1e-2
    np.testing.assert_allclose(motion.qpos[-1], data.qpos, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(motion.qvel[-1], data.qvel, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(motion.time, np.arange(STEPS + 1) * model.opt.timestep, rtol=1e-12)


def test_gradients_are_the_slopes_of_whole_motions(problem, x):
    J = tog.objective(problem, "mujoco")
    expected = differences(J, problem, x)
    assert np.abs(expected).min() > 1e-4  # Each counts.
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, expected, rtol=3e-6, atol=1e-6)
    with_checkpoints = jax.grad(tog.objective(problem, "mujoco", checkpoint=5))(jnp.asarray(x))
    np.testing.assert_allclose(with_checkpoints, jax.grad(J)(jnp.asarray(x)), rtol=1e-9, atol=1e-9)


def test_single_precision_is_that_of_what_moves_alone(problem, x):
    """What does not move stays in float64, and so do steps."""
    x = np.append(x[:-3], np.zeros(3))
    expected = jax.grad(tog.objective(problem, "mujoco"))(jnp.asarray(x))[:-3]
    single = held(variables=[tog.Parameters(*NUMBERS), tog.Start("mocap_pos")])
    with jax.enable_x64(False):
        found = jax.grad(tog.objective(single, "mujoco"))(jnp.asarray(x[:-3], jnp.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)


def drawn(problem: tog.Problem, count: int) -> tog.Starts:
    """Each start with its own frictions, masses (inertias and inverse weights stay) and mocap position."""
    model, origin = problem.scene.model, problem.origin

    def sample(key):
        friction, mass, place = jax.random.split(key, 3)
        return {
            "qvel": jnp.asarray(origin.qvel),
            "geom_friction": model.geom_friction
            * jax.random.uniform(friction, (model.ngeom, 1), minval=0.8, maxval=1.2),
            "body_mass": model.body_mass * jax.random.uniform(mass, (model.nbody,), minval=0.9, maxval=1.1),
            "mocap_pos": origin.mocap_pos + 0.01 * jax.random.normal(place, (1, 3)),
        }

    return tog.Starts(sample, count)


def test_starts_with_models_of_their_own_have_the_costs_and_gradients_of_mjx(problem, x):
    """Of each start, in numbers of the model and mocap bodies about its own ones; both engines on one smooth piece."""
    many, key = held(start=drawn(problem, 3)), jax.random.key(2)
    found = {}
    for engine in ("mjx", "mujoco"):
        J = tog.objective(many, engine)
        slope = jax.jit(lambda x, along, J=J: jax.jvp(lambda x: J.each(x, key), (x,), (along,)))
        found[engine] = [slope(jnp.asarray(x), jnp.asarray(along)) for along in np.diag(problem.bound.scale)]
    (expected, slopes), (costs, ours) = (
        map(np.array, zip(*found[engine], strict=True)) for engine in ("mjx", "mujoco")
    )
    assert np.ptp(expected[0]) > 1e-2
    np.testing.assert_allclose(costs, expected, rtol=1e-8)
    assert (np.abs(slopes).max(1) > 1e-5).all()
    np.testing.assert_allclose(ours, slopes, rtol=1e-6, atol=1e-7)


def test_starts_with_models_of_their_own_are_those_of_loops_over_mj_step(problem):
    """A drawn mass moves the whole mass matrix, also where C MuJoCo has it compiled as a constant diagonal."""
    starts, key = drawn(problem, 4), jax.random.key(3)
    many = held(start=starts, variables=tog.Start("mocap_pos[0, 2]"))
    motions = tog.objective(many, "mujoco").motion(jnp.zeros(1) + 1.0, key)
    samples = jax.vmap(starts.sample)(jax.random.split(key, 4))
    for i, (qpos, time) in enumerate(zip(motions.qpos, motions.time, strict=True)):
        model = copy.copy(problem.scene.model)
        model.geom_friction[:], model.body_mass[:] = samples["geom_friction"][i], samples["body_mass"][i]
        kept = model.body_invweight0.copy(), model.dof_invweight0.copy()
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.body_invweight0[:], model.dof_invweight0[:] = kept
        place = np.asarray(samples["mocap_pos"][i]).copy()
        place[0, 2] = 1.0
        data = copy_of(model, problem.origin, qvel=samples["qvel"][i], mocap_pos=place)
        for _ in range(STEPS):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(qpos[-1], data.qpos, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(time[-1], STEPS * 0.005, rtol=1e-12)


def test_runge_kutta_has_the_slopes_of_its_motions():
    """Of bodies that turn, a model that moves, and an activation; with a law in between."""
    spec = mujoco.MjSpec.from_string(BODIES.format(integrator="RK4"))
    kinds = [tog.Controls(knots=3), tog.Start("qpos"), tog.Start("qvel"), tog.Start("act")]
    parameters = tog.Parameters("body_mass[1]", "jnt_stiffness[2]", "dof_damping", "opt.gravity", "opt.timestep")
    gains = tog.Policy(lambda w, seen: jnp.tanh(w @ seen), np.full((2, 22), 0.1), every=3)
    for variables in ([*kinds, parameters], [gains, parameters]):
        problem = tog.Problem(spec, 12, variables, cost=distance, running_cost=speeds)
        x = problem.x0 + 0.1 * np.random.default_rng(0).normal(size=len(problem.x0)) * problem.bound.scale
        J = tog.objective(problem, "mujoco")
        expected = differences(J, problem, x)
        assert np.mean(np.abs(expected) > 1e-5) > 0.8
        for gradient in in_both_modes(J, x):
            np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("apart", [0.0, 3e-7])
def test_a_difference_that_crosses_a_touch_is_not_taken(apart):
    """Two balls at rest beside one another fall freely for one step, or touch if either grows or comes nearer."""
    more = f"""<body mocap="true" pos="{0.2 + apart} 0 1"><geom size="0.1" solref="-2000 -100"/></body>"""
    text = FLOOR.format(options="", joints=PLANAR, more=more).replace("0 0 0.099", "0 0 1")
    kinds = [tog.Parameters("field:geom_size[1, 0]"), tog.Start("mocap_pos"), tog.Start("mocap_quat")]
    start = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    start.qvel[0] = 0.2
    problem = tog.Problem(model, 1, kinds, cost=lambda last: last.qvel[0] + last.qpos[0], start=start)
    for gradient in in_both_modes(tog.objective(problem, "mujoco"), problem.x0):
        np.testing.assert_allclose(gradient, np.zeros(7), atol=1e-7)


def test_neither_the_number_of_threads_nor_what_ran_before_changes_a_bit(problem):
    """Of motions with models of their own, and their derivatives."""
    model, rng, parameter = problem.scene.model, np.random.default_rng(3), tog.Parameter(problem.model, "body_mass[1]")
    moved = parameter.moved(
        MovedModel.of(model).tree_replace({"geom_friction": jnp.asarray(model.geom_friction)}), jnp.zeros(1)
    )
    forwards = [Forward(model, problem.origin, threads).holding(moved) for threads in (1, 3)]
    start, controls = np.tile(forwards[0].start, (5, 1)), np.zeros((5, 40, 0))
    held_ = forwards[0].row * (1 + 0.05 * rng.uniform(size=(5, forwards[0].row.size)))
    held_[:, 0] = rng.uniform(-0.1, 0.1, size=5)

    def run(forward: Forward, some: slice) -> list[np.ndarray]:
        after = forward.motions(start[some], controls[some], held_[some])
        before = np.concatenate([start[some][:, None], after[:, :-1]], axis=1)
        rows = [part.reshape(len(after) * 40, part.shape[-1]) for part in (before, after, controls[some])]
        found = slopes(forward, rows[0], rows[1], rows[2], np.repeat(held_[some], 40, axis=0), is_held=True)
        return [after, *(part.reshape(len(after), 40, *part.shape[1:]) for part in found)]

    expected = run(forwards[0], slice(None))
    assert len({part.tobytes() for part in expected[0]}) == 5
    for forward in forwards:
        for some in (slice(2, 4), slice(None), slice(4, 5)):
            for part, of_all in zip(run(forward, some), expected, strict=True):
                np.testing.assert_array_equal(part, of_all[some])


def test_a_digest_knows_what_moves_with_a_number():
    """The programs are the same text but for what they leave to C MuJoCo."""
    model, digests = mujoco.MjModel.from_xml_string(FLOOR.format(options="", joints=PLANAR, more="")), set()
    for name in ("body_mass[1]", "field:body_mass[1]", "body_inertia[1, 0]"):
        problem = tog.Problem(model, 5, tog.Parameters(name), cost=distance)
        digests |= {function_digest(lowered(tog.objective(problem, "mujoco"), jnp.ones(1))) for _ in range(2)}
    assert len(digests) == 3


def test_a_descent_finds_the_friction_that_a_motion_was_made_with(problem):
    seen = tog.rollout(problem, np.append(0.4, problem.x0[1:]), "mujoco").qpos[-1]
    identify = held(
        variables=tog.Parameters("geom_friction[0, 0]"),
        cost=lambda last: jnp.sum((last.qpos - seen) ** 2),
        guess=[0.7],
        bounds=(0.3, 1.0),
    )
    found = tog.solve(identify, engine="mujoco", budget=300)
    np.testing.assert_allclose(found.best, 0.4, atol=1e-2)


def test_sites_of_what_has_moved_are_where_mj_kinematics_has_them():
    kinds = [tog.Parameters("site_pos[0, 0]"), tog.Start("mocap_pos"), tog.Start("mocap_quat")]
    problem = held(variables=kinds, steps=1, cost=lambda last: last.site("tip") @ jnp.array([1.0, 2.0, 3.0]))
    x = problem.x0 + np.array([0.1, 0.2, 0.3, 0.4, 0.5, -0.4, 0.3])

    def value(x):
        quat = problem.origin.mocap_quat[0].copy()
        mujoco.mju_quatIntegrate(quat, x[4:], 1.0)
        data = copy_of(model, problem.origin, mocap_pos=x[None, 1:4], mocap_quat=quat[None])
        model.site_pos[0, 0] = x[0]
        mujoco.mj_kinematics(model, data)
        return data.site("tip").xpos @ [1, 2, 3]

    J, model = tog.objective(problem, "mujoco"), copy.copy(problem.scene.model)
    np.testing.assert_allclose(J(x), value(x), rtol=1e-12)
    expected = [(value(x + 1e-6 * e) - value(x - 1e-6 * e)) / 2e-6 for e in np.eye(7)]
    np.testing.assert_allclose(jax.grad(J)(jnp.asarray(x)), expected, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("name", ["body_ipos[1, 0]", "jnt_axis[0, 2]"])
def test_what_c_has_compiled_as_a_diagonal_is_one_line_and_moves_where_it_is_not(name):
    text = FLOOR.format(options="", joints=PLANAR, more="").replace("0 0 0.099", "0 0 1")

    def moving(text: str) -> tog.Problem:
        model, parameter = mujoco.MjModel.from_xml_string(text), tog.Parameters(f"field:{name}")
        start = mujoco.MjData(model)
        start.qvel[:], start.ctrl[:] = (0.3, 0.2, 5.0), (30.0, 20.0)
        return tog.Problem(model, 3, parameter, cost=lambda last: last.qvel @ jnp.arange(1.0, 4.0), start=start)

    simple = moving(text)
    for move in (tog.objective(simple, "mujoco"), tog.Parameter(simple.scene.model, f"field:{name}").in_c):
        with pytest.raises(tog.InputError, match=r"cannot move .* simple='false' at that <body>") as caught:
            move(simple.x0)
        assert "\n" not in str(caught.value)
    other = moving(text.replace("<body pos", "<body simple='false' pos"))
    J, x = tog.objective(other, "mujoco"), other.x0 + 0.02
    moved = tog.Parameter(other.scene.model, f"field:{name}").in_c(x)
    data = copy_of(moved, other.origin)
    mujoco.mj_step(moved, data, 3)
    np.testing.assert_allclose(J(x), data.qvel @ [1, 2, 3], rtol=1e-12)
    assert abs(float(J(x) - J(other.x0))) > 1e-3
    np.testing.assert_allclose(jax.grad(J)(jnp.asarray(x)), differences(J, other, x), rtol=1e-6)
