"""The jumps of touch-downs on C MuJoCo in what is held: against closed forms, the jumps in positions, and slopes over
many phases of the time grid."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.measured.linearised import Linearised
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.gaps import STILL
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.mjcf.fields import assign, attribute
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.stepping.mjx_state import copy_of

HOW = {"differentiation": "saltation"}
STIFFNESS, DAMPING, SPEED = 1000.0, 20.0, 1.0
# A ball flies to a box in a mocap body's hand, far from its middle; a hinge and a tendon to their limits.
BOUNCES = f"""<mujoco><option timestep="0.001" gravity="0 0 0" tolerance="1e-14"/>
  <default><geom solref="{-STIFFNESS} {-DAMPING}" solimp="0.8 0.8 0.01"/>
    <joint solreflimit="{-STIFFNESS} {-DAMPING}" solimplimit="0.8 0.8 0.01"/></default>
  <worldbody><body mocap="true" pos="-0.5 0 -0.1"><geom name="box" type="box" size="1 1 0.1" condim="1"/></body>
    <body name="ball" pos="0 0 0.2"><joint type="slide" axis="0 0 1"/>
      <geom name="ball" size="0.1" mass="1" condim="1"/></body>
    <body pos="9 0 0"><joint type="hinge" axis="0 1 0" range="-9 0.1" limited="true"/>
      <geom size="0.1" pos="0.3 0 0"/></body>
    <body pos="0 9 0"><joint name="pulled" type="slide" axis="1 0 0"/><geom size="0.1"/></body></worldbody>
  <compiler angle="radian"/>
  <tendon><fixed range="-9 0.1" limited="true" solreflimit="{-STIFFNESS} {-DAMPING}" solimplimit="0.8 0.8 0.01">
    <joint joint="pulled" coef="1"/></fixed></tendon></mujoco>"""
WEIGHTS = np.array([1.0, 3.0, 5.0])
PARAMETERS = (
    "body_pos[2, 2]",
    "geom_size[1, 0]",
    "geom_margin[1]",
    "jnt_range[1, 1]",
    "tendon_range[0, 1]",
    "body_mass[2]",
    "geom_friction[1, 0]",
)


def bounces(**of) -> tog.Problem:
    spec = mujoco.MjSpec.from_string(BOUNCES)
    start = mujoco.MjData(spec.compile())
    start.qvel[:] = -SPEED, SPEED, SPEED
    kinds = [tog.Start("qpos"), tog.Parameters(*PARAMETERS), tog.Start("mocap_pos[0, 2]"), tog.Start("mocap_quat")]
    of = {"variables": kinds, "start": start, "steps": 300, **of}
    return tog.Problem(spec, cost=lambda last: last.qpos @ jnp.asarray(WEIGHTS), **of)


def gradients(problem: tog.Problem, x: np.ndarray, **options) -> dict[str, np.ndarray]:
    """At the points x [N, n], by the variables' names."""
    J = tog.objective(problem, "mujoco", **options)
    found = np.asarray(jax.jit(jax.vmap(jax.grad(J)))(jnp.asarray(x)))
    return dict(zip(problem.bound.names, found.T, strict=True))


def restitution() -> float:
    """Where its impedance is constant a contact is a spring and a damper that act below 0 and never pull: a mass leaves
    with e times its speed."""
    decay = DAMPING / 2
    omega = np.sqrt(STIFFNESS - decay**2)
    time = (np.pi - np.arctan2(DAMPING * omega, STIFFNESS - DAMPING * decay)) / omega
    return float(np.exp(-decay * time) * (decay / omega * np.sin(omega * time) - np.cos(omega * time)))


def test_where_something_bounces_moves_its_end_by_1_and_e():
    """q ends at h + f(q0 - h) if it bounces at h, where f' is -e, and at each phase the slope in q0: so it moves with h
    as 1 - f' has it. A lever moves the box up and down, and neither masses nor frictions count."""
    problem, phases = bounces(), 10
    x = np.tile(problem.x0, (phases, 1))
    x[:, :3] += np.outer(SPEED * problem.scene.model.opt.timestep * np.arange(phases) / phases * 7, [1, -1, -1])

    def ways(x: np.ndarray, **options) -> np.ndarray:
        found = gradients(problem, x, **options)
        ways = WEIGHTS[:, None] - [found[f"qpos[{i}]"] for i in range(3)]
        for name, expected in {
            "body_pos[2, 2]": -ways[0],
            "geom_size[1, 0]": ways[0],
            "geom_margin[1]": ways[0],
            "mocap_pos[0, 2]": ways[0],
            "mocap_quat[0, 1]": -0.5 * ways[0],
            "jnt_range[1, 1]": ways[1],
            "tendon_range[0, 1]": ways[2],
            "body_mass[2]": np.zeros(len(x)),
            "geom_friction[1, 0]": np.zeros(len(x)),
        }.items():
            np.testing.assert_allclose(found[name], expected, rtol=1e-6, atol=1e-6, err_msg=name)
        return ways.mean(1) / WEIGHTS / (1 + restitution())

    np.testing.assert_allclose(ways(x, **HOW), 1, rtol=0.01)
    assert (np.abs(ways(x[:2]) - 1) > 0.3).all()


STOPPED = """<mujoco><option timestep="0.002" cone="elliptic" tolerance="1e-14"/>
  <default><geom friction="0.1"/></default>
  <worldbody><geom type="plane" size="5 5 1" friction="0.3"/>
    <body pos="0 0 0.099"><joint type="slide" axis="1 0 0" range="-1 0.2" limited="true" damping="2"
      solreflimit="-1000 -20"/><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body>
  </worldbody></mujoco>"""


@pytest.mark.parametrize(("name", "half"), [("body_mass[1]", 0.3), ("geom_friction[0, 0]", 0.1)])
def test_masses_and_frictions_count_through_the_states_that_they_change(name, half):
    """Over many phases of the time grid the mean of the gradients is the slope, by least squares, of where a ball ends
    that drag and the floor brake, and that meets a limit: of autodiff's error nine tenths go, as in the table."""
    spec = mujoco.MjSpec.from_string(STOPPED)
    start = mujoco.MjData(spec.compile())
    start.qvel[0] = 2.0
    problem = tog.Problem(spec, 80, tog.Parameters(name), cost=lambda last: last.qpos[0], start=start)
    along, at = (np.linspace(-half, half, points)[:, None] for points in (201, 32))
    ends = jax.jit(jax.vmap(tog.objective(problem, "mujoco")))(jnp.asarray(problem.x0 + along))
    slope = np.polyfit(along[:, 0], np.asarray(ends), 1)[0]
    # The weights that least squares have.
    weights = 1 - (at[:, 0] / half) ** 2
    left, before = (
        abs(np.average(gradients(problem, problem.x0 + at, differentiation=how)[name], weights=weights) / slope - 1)
        for how in ("saltation", "implicit")
    )
    assert before > 0.4
    assert left < 0.1 * before


def test_each_start_has_the_jumps_of_its_own_model():
    """Of balls of sizes that are drawn, in where the box is held and in how heavy the ball is."""
    kinds = [tog.Parameters("geom_margin[1]"), tog.Start("mocap_pos[0, 2]")]
    single = bounces(variables=kinds)
    model, origin = single.scene.model, single.origin

    def sample(key):
        size = jax.random.uniform(key, minval=0.09, maxval=0.11)
        return {"qvel": jnp.asarray(origin.qvel), "geom_size": jnp.asarray(model.geom_size).at[1, 0].set(size)}

    many, key = bounces(variables=kinds, start=tog.Starts(sample, 3)), jax.random.key(0)
    found = jax.jacfwd(lambda x: tog.objective(many, "mujoco", **HOW).each(x, key))(jnp.asarray(many.x0))
    sized = bounces(variables=[*kinds, tog.Parameters("field:geom_size[1, 0]")])
    sizes = jax.vmap(sample)(jax.random.split(key, 3))["geom_size"][:, 1, 0]
    x = np.column_stack([np.tile(single.x0, (3, 1)), sizes])
    expected = gradients(sized, x, **HOW)
    assert np.ptp(expected["geom_margin[1]"]) > 1e-3
    np.testing.assert_allclose(found.T, [expected[name] for name in single.bound.names], rtol=1e-6)


def test_neither_threads_nor_what_ran_before_changes_a_bit():
    """Of bounces off what is held differently, each with its model."""
    problem = bounces()
    model, steps = problem.scene.model, 130
    moved = tog.Parameter(problem.model, "geom_size[1, 0]").moved(MovedModel.of(model), jnp.zeros(1))
    forwards = [Forward(model, problem.origin, threads, "saltation").holding(moved) for threads in (1, 3)]
    held, states = np.tile(forwards[0].row, (2, 1)), np.tile(forwards[0].start, (2, 1))
    held[1, 0], held[1, 3] = 0.001, -0.102
    after = forwards[0].motions(states, np.zeros((2, steps, 0)), held)
    before = np.concatenate([states[:, None], after[:, :-1]], axis=1)
    rows = before.reshape(-1, states.shape[1]), after.reshape(-1, states.shape[1])
    held = held.repeat(steps, 0)

    def run(forward: Forward, some: slice) -> np.ndarray:
        given = rows[0][some], rows[1][some], np.zeros((len(rows[0][some]), 0)), held[some]
        return slopes(forward, *given, is_held=True).held

    expected = run(forwards[0], slice(None))
    plain = run(Forward(model, problem.origin, 1).holding(moved), slice(None))
    switching = (np.abs(expected - plain).max((1, 2)) > 1).reshape(2, steps)
    assert (switching.any(1) & ~switching.all(1)).all()
    for some in (slice(80, 200), slice(None), slice(229, 230)):
        np.testing.assert_array_equal(run(forwards[1], some), expected[some])


def test_a_verdict_has_the_same():
    problem = bounces()
    found = gradients(problem, problem.x0[None], **HOW)
    for name in ("geom_size[1, 0]", "mocap_pos"):
        scene = SceneFunction(problem.scene.model, problem.origin, problem.steps, name, "qpos", **HOW)
        of_place = Linearised(scene, np.eye(len(scene.x.names))).run().slopes
        np.testing.assert_allclose(WEIGHTS @ of_place[:, -1], found["mocap_pos[0, 2]"], rtol=1e-6)


def test_what_is_said_to_move_no_gap_moves_none():
    """Of bounces that touch, and of all that MuJoCo computes of positions before forces; sizes do."""
    problem = bounces()
    given, moving = problem.scene.model, []

    def gaps(model: mujoco.MjModel) -> np.ndarray:
        data = copy_of(model, problem.origin)
        data.qpos[:] = -0.101, 0.101, 0.101
        mujoco.mj_fwdPosition(model, data)
        rows = data.efc_type >= int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)
        return np.append((data.efc_pos - data.efc_margin)[rows], data.contact.dist - data.contact.includemargin)

    for name in sorted(STILL | {"geom_size", "jnt_range", "tendon_range", "geom_margin", "body_pos"}):
        model = copy.copy(given)
        value = np.asarray(attribute(model, name))
        if not value.size:
            continue
        assign(model, name, value + 1e-4 * np.random.default_rng(0).uniform(1, 2, value.shape))
        before, after = (gaps(some) for some in (given, model))
        assert before.shape == after.shape == (4,)
        if (before != after).any():
            moving.append(name)
    assert moving == ["body_pos", "geom_margin", "geom_size", "jnt_range", "tendon_range"]


HELD = """<mujoco><option timestep="0.002" gravity="0 0 -0.001"/><worldbody>
  <body mocap="true"><geom name="held" type="{held}" size="0.125 0.25 0.125"/></body>
  <body pos="0 0 {height}"><joint type="slide" axis="0 0 1"/>
    <geom type="{falling}" size="0.125 0.0625 0.0625" mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("held", "falling", "height", "speed"),
    [
        ("box", "cylinder", 0.1875, -1.0),
        ("ellipsoid", "ellipsoid", 0.1875, -1.0),
        ("box", "sphere", 0.25, 0.0),
    ],
)
def test_a_gap_moves_with_what_is_held_as_with_what_falls(held, falling, height, speed):
    """Also a distance that MuJoCo searches for, and one at the surface where nothing goes as far as a difference."""
    away = 5e-4 * (speed != 0)
    model = mujoco.MjModel.from_xml_string(HELD.format(held=held, falling=falling, height=height + away))
    start = mujoco.MjData(model)
    start.qvel[:] = speed
    forward = Forward(model, start, 1, "saltation")
    after = forward.motions(forward.start[None], np.zeros((1, 1, 0)))[0]
    found = slopes(forward, forward.start[None], after, np.zeros((1, 0)), is_held=True)
    in_qpos, in_mocap = found.state[0, 1, 0], found.held[0, 2, :3]
    assert in_qpos < -50
    np.testing.assert_allclose(in_mocap, [0, 0, -in_qpos], rtol=1e-6, atol=1e-6 * abs(in_qpos))
