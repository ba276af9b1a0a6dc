"""The jumps of touch-downs on C MuJoCo: against closed forms, the jumps of its own steps, MJX's means over many phases,
and the planar penalty simulator."""

import runpy
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
import pytest
from test_saltation import HELD
from test_touch import LANDING

import tog_mjx as tog
from tog_mjx.engines.c_mujoco.forward import Forward
from tog_mjx.engines.c_mujoco.linearise import Slopes, slopes
from tog_mjx.stepping.touch import KICKS

ROOT = Path(__file__).parent.parent
FINDINGS = ROOT / "scripts" / "findings"
HOW = {"differentiation": "saltation"}
BOUNCE = """<mujoco><option timestep="0.001" gravity="0 0 0" solver="{solver}" tolerance="1e-14" iterations="100"/>
  <default><geom solref="-1000 -20" solimp="0.8 0.8 0.01" condim="1"/></default>
  <worldbody><geom type="plane" size="5 5 1"/>
  <body><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


def gradients(problem: tog.Problem, x: np.ndarray, engine: str = "mujoco", **options) -> np.ndarray:
    """At the points x [N, n]."""
    J = tog.objective(problem, engine, **options)
    return np.asarray(jax.jit(jax.vmap(jax.grad(J)))(jnp.asarray(x)))


def derivative(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, how: str = "saltation") -> Slopes:
    """Of one step."""
    start = mujoco.MjData(model)
    start.qpos[:], start.qvel[:] = qpos, qvel
    forward, controls = Forward(model, start, differentiation=how), np.zeros((1, 1, model.nu))
    return slopes(forward, forward.start[None], forward.motions(forward.start[None], controls)[0], controls[0])


@pytest.mark.parametrize("solver", ["Newton", "PGS"])
def test_a_bounce_obeys_its_law(solver):
    """Where its impedance is constant a contact is a spring and a damper that act below 0 and never pull: a mass leaves
    with e times its speed, so that where it is in the end moves by -e times where it began. MJX refuses PGS."""
    stiffness, damping, speed = 1000.0, 20.0, 1.0
    model = mujoco.MjModel.from_xml_string(BOUNCE.format(solver=solver))
    start = mujoco.MjData(model)
    start.qpos[0], start.qvel[0] = 0.2, -speed
    problem = tog.Problem(model, 300, tog.Start("qpos"), cost=lambda last: last.qpos[0], start=start)
    # 20 phases of the time grid.
    shifts = (speed * model.opt.timestep * np.arange(20) / 20 * 7)[:, None]
    decay = damping / 2
    omega = np.sqrt(stiffness - decay**2)
    time = (np.pi - np.arctan2(damping * omega, stiffness - damping * decay)) / omega
    restitution = np.exp(-decay * time) * (decay / omega * np.sin(omega * time) - np.cos(omega * time))
    assert abs(gradients(problem, shifts, **HOW).mean() / -restitution - 1) <= 0.01
    assert abs(gradients(problem, shifts).mean() / -restitution - 1) > 0.3


@pytest.mark.parametrize(
    "name",
    [
        "thrown ball, elliptic cone, direct solref",
        "limit of a ball joint",
        "dumbbell, two contacts at once",
    ],
)
def test_scene_by_scene_it_is_that_of_mjx(name):
    """The mean over many phases, to the digits of the table."""
    study, timestep, table = runpy.run_path(str(FINDINGS / "touch_scenes.py")), 0.005, FINDINGS / "touch_scenes.csv"
    (row,) = pd.read_csv(table).query("scene == @name and timestep == @timestep").itertuples()
    scene = next(scene for scene in study["scenes"]() if scene["name"] == name)
    function = study["function_of"](scene, timestep)
    site, axis = function.output.removesuffix("]").split("[")
    problem = tog.Problem(
        function.model,
        function.steps,
        tog.Start(function.wrt),
        cost=lambda last: last.site(site)[int(axis)],
        start=function.start,
    )
    at = study["window"](scene["half"], study["POINTS"])
    found = study["mean"](scene, gradients(problem, problem.x0 + at[:, None], **HOW)[:, 0])
    np.testing.assert_allclose(found, row.saltation, rtol=1e-5)
    assert abs(row.autodiff - row.saltation) > 0.1 * abs(row.saltation)


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_on_the_tasks_it_is_that_of_the_penalty_simulator(name):
    """Whose motion is the same in the limit of soft contact, and whose switch is differentiated by JAX."""
    task = tog.get_task(name)
    low, high = np.array(task.window).T
    points = np.random.default_rng(20).uniform(low, high, (8, 2))
    x = np.array([task.expand(point) for point in jnp.asarray(points)])
    expected = gradients(task, x, "penalty", **HOW)
    moving = np.linalg.norm(expected, axis=1) > 1e-6
    assert moving.sum() >= 3

    def error(found: np.ndarray) -> float:
        return float(
            np.median(np.linalg.norm(found - expected, axis=1)[moving] / np.linalg.norm(expected[moving], axis=1))
        )

    assert error(gradients(task, x, **HOW)) < 0.01
    assert error(gradients(task, x)) > 0.02


@pytest.mark.parametrize(
    ("cone", "integrator"),
    [("elliptic", "Euler"), ("pyramidal", "Euler"), ("elliptic", "implicit"), ("pyramidal", "implicitfast")],
)
def test_what_switches_together_counts_once_as_the_integrator_has_it(cone, integrator):
    """Two spheres of one body land flat, beside a joint and a tendon that meet their limits; all are damped."""
    file = LANDING.format(cone=cone).replace("<joint name", '<joint damping="40" name')
    model = mujoco.MjModel.from_xml_string(file.replace("<option", f'<option integrator="{integrator}"'))
    dt, speeds = model.opt.timestep, np.array([-1.0, 0.0, 0.8, 0.6])
    at_surface, inwards = np.array([0.1, 0.0, 0.0, 0.0]), np.array([-1.0, 0.0, 1.0, 1.0])

    def after_in_c(gap) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = at_surface - gap * inwards, speeds
        mujoco.mj_step(model, data)
        return data.qacc.copy(), data.qpos.copy(), data.qvel.copy()

    moving = [0, 2, 3]
    kick, *jump = (closed - open_ for closed, open_ in zip(after_in_c(-1e-9), after_in_c(1e-9), strict=True))
    jump[0] -= 2e-9 * inwards  # What lies apart before the step.
    width = np.maximum(np.abs(speeds) * dt, KICKS * np.abs(kick) * dt**2)
    for side in (-0.4, -0.05, 0.05, 0.4):
        place = at_surface - side * width * inwards, speeds
        added = derivative(model, *place).state[0] - derivative(model, *place, "implicit").state[0]
        of_positions, of_velocities = added[:4, :4], added[4:, :4]
        for found, expected in zip((of_positions, of_velocities), jump, strict=True):
            slope = expected[moving] * inwards[moving] / width[moving]
            np.testing.assert_allclose(np.diag(found)[moving], slope, rtol=1e-4, atol=1e-12)
        np.testing.assert_array_equal(added[:, 4:], 0.0)
    apart = at_surface - 0.6 * width * inwards, speeds
    np.testing.assert_array_equal(derivative(model, *apart).state, derivative(model, *apart, "implicit").state)


def test_margins_move_the_surface():
    """And gaps beyond them do not: as far from it all is the same."""
    margin = 0.0078125  # Numbers that add up without rounding.
    given = LANDING.format(cone="elliptic").replace('size="0.1"', 'size="0.125"')
    wider = given.replace('<geom type="plane"', f'<geom margin="{margin}" gap="0.02" type="plane"').replace(
        "<joint name", f'<joint margin="{margin}" name'
    )
    wider = wider.replace("<fixed ", f'<fixed margin="{margin}" ')
    found = []
    for file, moved in ((given, 0.0), (wider, margin)):
        model, inwards = mujoco.MjModel.from_xml_string(file), np.array([-1.0, 0.0, 1.0, 1.0])
        place = np.array([0.125, 0.0, 0.0, 0.0]) - (moved + 0.00048828125) * inwards, inwards
        found.append(derivative(model, *place).state - derivative(model, *place, "implicit").state)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
    assert (np.abs(np.diag(found[0][0][4:]))[[0, 2, 3]] > 50).all()


def test_a_hit_makes_slide_what_the_floor_held():
    """The jump is that of the motion: by its derivative the floor's friction would grow without bound."""
    model = mujoco.MjModel.from_xml_string(HELD)
    speeds, width = np.array([0.0, 0.0, 1.0]), model.opt.timestep

    def in_c(position):
        data = mujoco.MjData(model)
        data.qpos[2], data.qvel[:] = position, speeds
        mujoco.mj_step(model, data)
        return data.qvel.copy()

    jump = in_c(1e-9) - in_c(-1e-9)
    assert jump[0] > 0.05
    for side in (-0.05, 0.05):
        place = np.array([0.0, 0.0, side * width]), speeds
        added = derivative(model, *place).state[0] - derivative(model, *place, "implicit").state[0]
        np.testing.assert_allclose(added[3:, 2], jump / width, rtol=1e-3, atol=1e-4 * jump[0] / width)


AT_REST = """<mujoco><option timestep="0.002" cone="elliptic"/><worldbody><geom type="plane" size="5 5 1"/>
  <body pos="0 0 0.0996"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
  <body pos="3 0 1"><joint type="ball" range="0 1.5" limited="true"/><geom size="0.1" pos="0.3 0 0" mass="1"/></body>
  </worldbody></mujoco>"""


def test_where_nothing_touches_anew_it_is_the_implicit_gradient():
    """To the bit: what lies deep in its contact, and what hangs within its limit."""
    model = mujoco.MjModel.from_xml_string(AT_REST)
    place = mujoco.MjData(model).qpos, np.random.default_rng(0).normal(size=model.nv) * 1e-3
    for found, expected in zip(derivative(model, *place), derivative(model, *place, "implicit"), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_neither_threads_nor_what_ran_before_changes_a_bit():
    """Of a cube that is thrown, which touches with one corner after the other."""
    model = mujoco.MjModel.from_xml_path(str(ROOT / "tests" / "scenes" / "touch" / "thrown_cube.xml"))
    start = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, start, 0)
    forwards = [Forward(model, start, threads, "saltation") for threads in (1, 3)]
    steps, controls = 100, np.zeros((1, 100, model.nu))
    after = forwards[0].motions(forwards[0].start[None], controls)[0]
    before = np.concatenate([forwards[0].start[None], after[:-1]])
    expected = slopes(forwards[0], before, after, controls[0])
    plain = slopes(Forward(model, start, 1), before, after, controls[0])
    assert 0 < (np.abs(expected.state - plain.state).max((1, 2)) > 0.1).sum() < steps
    for some in (slice(60, 100), slice(None), slice(50, 51)):
        found = slopes(forwards[1], before[some], after[some], controls[0, some])
        np.testing.assert_array_equal(found.state, expected.state[some])


HELD_BOX = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
  <body mocap="true" pos="0 0 -0.1"><geom type="box" size="1 1 0.1"/></body>
  <body><joint type="slide" axis="0 0 1"/><geom size="0.125" mass="1"/></body></worldbody></mujoco>"""


def test_each_step_has_what_it_holds():
    """A ball just above a box has a jump, and none where the box is held lower."""
    model = mujoco.MjModel.from_xml_string(HELD_BOX)
    start = mujoco.MjData(model)
    start.qpos[:], start.qvel[:] = 0.1255, -1.0
    forward, controls = Forward(model, start, 1, "saltation"), np.zeros((3, 1, 0))
    held, states = np.tile(forward.row, (3, 1)), np.tile(forward.start, (3, 1))
    held[1, 2] -= 0.05
    after = forward.motions(states, controls, held)[:, 0]
    found = slopes(forward, states, after, controls[:, 0], held).state[:, 1, 0]
    np.testing.assert_array_equal(found[[1, 2]], [0.0, found[0]])
    assert found[0] < -50


def test_rk4_has_none():
    model = mujoco.MjModel.from_xml_string(AT_REST)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    problem = tog.Problem(model, 2, tog.Start("qvel"), cost=lambda last: last.qpos[0])
    told = r"RK4.* four stages of .*take engine mjx"
    with pytest.raises(tog.InputError, match=told):
        jax.grad(tog.objective(problem, "mujoco", **HOW))(jnp.zeros(model.nv))
    with pytest.raises(tog.InputError, match=told):
        tog.check_scene(model, engine="mujoco", steps=2, differentiation="saltation")
