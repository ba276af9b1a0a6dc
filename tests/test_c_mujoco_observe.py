"""What a State shows on C MuJoCo: poses, sensors and accelerations, and their derivatives, against MJX's, MuJoCo's own
and differences of whole motions."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from c_mujoco_scenes import STEPS, by_hand, differences, in_both_modes

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.engines.c_mujoco import moment
from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.engines.engine import make_engine
from tog_mjx.problems.outputs import Outputs
from tog_mjx.stepping.mjx_state import MOVING, START, copy_of

# A turned block that slides on a floor, with an arm whose actuator has an activation, and one whose control is limited.
ARM = """
<mujoco model="arm">
  <option timestep="0.005" integrator="{integrator}" tolerance="1e-14" iterations="100" ls_iterations="50"
    cone="elliptic" impratio="2" solver="{solver}"/>
  <default><geom solref="0.05 1"/></default>
  <worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="block" pos="0 0 0.09"><freejoint/><geom size="0.1" mass="1"/>
      <site name="top" pos="0.02 0.03 0.1"/><site name="all" size="0.2"/>
      <body name="arm" pos="0 0 0.1"><joint name="elbow" axis="0 1 0.2" damping="0.1"/>
        <geom type="{kind}" size="0.03 0.1 0.05" pos="0 0 0.15" mass="0.3"/><site name="tip" pos="0.1 0 0.25"/></body>
    </body>
    <body name="hand" mocap="true" pos="1 1 1"/>
  </worldbody>
  <actuator>
    <general name="filtered" joint="elbow" dyntype="filter" dynprm="0.05" gainprm="2"/>
    <motor name="limited" site="top" gear="1 0.5 0.2 0.1 0 0.2" ctrllimited="true" ctrlrange="-1 0.4"/>
  </actuator>
  <sensor>
    <accelerometer name="felt" site="tip"/><framepos name="place" objtype="site" objname="tip"/>
    <gyro name="turning" site="top"/><touch name="pressed" site="all"/><force site="tip"/><torque site="tip"/>
    <framelinvel objtype="body" objname="arm"/><framequat objtype="body" objname="block"/>
    <actuatorfrc actuator="filtered"/><jointvel name="speed" joint="elbow"/><jointpos name="angle" joint="elbow"/>
    <subtreelinvel body="block"/><framelinacc objtype="site" objname="tip"/><clock/>
  </sensor>
  <keyframe><key qpos="0.1 0.2 0.098 0.9 0.3 -0.2 0.1 0.3" qvel="0.5 0.1 -0.02 0.2 -1 0.4 0.7" act="0.3"
    ctrl="0.2 0.3"/></keyframe>
</mujoco>"""


def arm(integrator: str = "Euler", solver: str = "Newton", kind: str = "capsule", **of) -> tog.Problem:
    model = mujoco.MjModel.from_xml_string(ARM.format(integrator=integrator, solver=solver, kind=kind))
    return tog.Problem(model, **{"steps": STEPS, "variables": tog.Controls(2), "cost": lambda last: last.time, **of})


def refused(**of) -> tog.Problem:
    """The arm, as MJX refuses it."""
    return arm("implicit", "PGS", "ellipsoid", **of)


def moments(problem: tog.Problem) -> np.ndarray:
    """States [2, s]: the start, and one beside it."""
    start = Forward(problem.scene.model, problem.origin).start
    other = start.copy()
    other[9:18] += np.random.default_rng(0).normal(size=9) * 0.1
    return np.stack([start, other])


def of_fields(problem: tog.Problem, engine: str, see: Callable[[tog.State], Any]) -> Callable:
    """`see` of the State with (qpos, qvel, act) [16] and controls [2]."""
    of = make_engine(problem, engine)
    start = {name: getattr(of.origin, name) for name in START}

    def seen(fields, ctrl):
        moving = dict(zip(MOVING, jnp.split(fields, [8, 15]), strict=True))
        return see(of.state(of.model, of.begin(of.model, {**start, **moving}), jnp.asarray(ctrl)))

    return seen


CTRL = np.array([0.2, 0.4])
"""The second is at its limit."""


def given(forward: Forward) -> tuple[np.ndarray, np.ndarray]:
    """The controls and what is held of two moments."""
    return np.tile(CTRL, (2, 1)), np.tile(forward.row, (2, 1))


def test_all_that_is_seen_is_what_mjx_sees():
    """Also as the outputs of a verdict, of the State of either engine."""
    problem = arm()
    acceleration, felt = (Outputs(problem.scene.model, of, "implicit") for of in ("acc", "felt"))

    def see(state: tog.State) -> jax.Array:
        parts = state.sensordata, acceleration.seen(state), felt.seen(state), state.sensor("angle")
        return jnp.concatenate([*parts, state.site("tip"), state.body("arm"), state.body("hand")])

    fields = jnp.asarray(moments(problem)[1, 1:17])
    expected, found = (compile_quickly(of_fields(problem, engine, see))(fields, CTRL) for engine in ("mjx", "mujoco"))
    assert found[problem.scene.model.sensor("pressed").adr[0]] > 1  # It stands on the floor.
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_slopes_of_sensors_are_those_of_mujoco(integrator):
    """Which has them for Euler: what a moment shows does not depend on how a step goes on from it."""
    problem, euler = arm(integrator), arm().scene.model
    states, data = moments(problem), copy_of(euler, arm().origin)
    forward = Forward(problem.scene.model, problem.origin)
    found = moment.Dynamics(forward, moment.ACC).slopes(states, *given(forward))
    for state, slopes in zip(states, found, strict=True):
        mujoco.mj_setState(euler, data, state, STATE)
        data.ctrl[:] = CTRL
        of_state, of_controls = np.zeros((euler.nsensordata, 15)), np.zeros((euler.nsensordata, 2))
        mujoco.mjd_transitionFD(euler, data, 1e-6, True, None, None, of_state, of_controls)
        size = np.abs(of_state).max(1, keepdims=True) + 1e-3
        np.testing.assert_allclose(slopes / size, np.hstack([of_state, of_controls]) / size, atol=1e-7)


def test_costs_of_what_is_seen_have_the_slopes_of_whole_motions():
    """On a model that MJX refuses; of all that a State shows, at each step and at the last."""

    def running(state: tog.State) -> jax.Array:
        return jnp.tanh(state.sensordata).sum() + state.site("tip")[2] + 0.01 * state.qacc @ state.qacc

    def last(state: tog.State) -> jax.Array:
        places = state.site("tip") @ state.body("arm") + state.body("hand")[0]
        return places + state.sensor("felt")[0] + state.sensor("speed")[0] * state.sensor("angle")[0]

    def by_name(data: mujoco.MjData) -> float:
        felt, speed, angle = (data.sensor(name).data[0] for name in ("felt", "speed", "angle"))
        return data.site("tip").xpos @ data.body("arm").xpos + data.body("hand").xpos[0] + felt + speed * angle

    variables = [tog.Controls(), tog.Start("qpos"), tog.Start("qvel[6]"), tog.Start("act")]
    problem = refused(variables=variables, cost=last, running_cost=running)
    with pytest.raises(tog.InputError, match="MJX does not support"):
        tog.objective(problem, "mjx")
    J, x = tog.objective(problem, "mujoco"), np.array([0.3, -0.2, *[0.01] * 7, 0.6, 0.1])
    expected = differences(J, x)
    assert np.abs(expected).min() > 1e-4  # Each variable counts.
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-5)
    motion = tog.rollout(problem, x, "mujoco")
    start = {name: getattr(motion, name)[0] for name in ("qpos", "qvel")} | {"act": x[-1:]}
    data = by_hand(problem, start, lambda _, step: motion.ctrl[step])
    mujoco.mj_forward(problem.scene.model, data)
    found = tog.objective(dataclasses.replace(problem, running_cost=None), "mujoco")(x)
    np.testing.assert_allclose(found, by_name(data), rtol=1e-10)


def test_what_is_seen_follows_what_is_held():
    """On a model that MJX refuses: parameters and mocap poses move places and sensors, at each step and at the last."""

    def running(state: tog.State) -> jax.Array:
        return jnp.tanh(state.sensordata).sum() + state.site("tip")[2] + state.qacc[-1]

    def last(state: tog.State) -> jax.Array:
        return state.site("tip") @ state.body("hand") + state.sensor("felt")[0] + state.site("top")[0]

    parameters = tog.Parameters("body_pos[2]", "site_pos[0, 1]", "body_mass[2]", "opt.gravity[2]")
    variables = [parameters, tog.Start("mocap_pos"), tog.Start("mocap_quat"), tog.Controls()]
    problem = refused(variables=variables, cost=last, running_cost=running)
    J, x = tog.objective(problem, "mujoco"), problem.x0 + 0.03
    expected, names = differences(J, x, 1e-6), np.array(problem.bound.names)
    # Where a mocap body is turned is seen by nobody.
    moving = np.array([not name.startswith("mocap_quat") for name in names])
    assert np.abs(expected[moving]).min() > 1e-4
    for gradient in in_both_modes(J, x):
        np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-5)


def test_only_what_is_asked_for_is_computed_and_nothing_is_left_of_it(monkeypatch):
    """A sensor of positions or velocities needs no solver; and where it was computed before, what it needs not is
    not shown."""
    forward = Forward((problem := arm()).scene.model, problem.origin)
    states, model = moments(problem), forward.model
    numbers = {stage: moment.Dynamics(forward, stage) for stage in (moment.POS, moment.VEL, moment.ACC)}
    every = numbers[moment.ACC].values(states, *given(forward))
    slopes = numbers[moment.ACC].slopes(states, *given(forward))

    def fail(*_):
        raise AssertionError

    monkeypatch.setattr(mujoco, "mj_forwardSkip", fail)
    for stage in (moment.VEL, moment.POS):
        some = np.repeat(model.sensor_needstage <= stage, model.sensor_dim)
        assert 0 < some.sum() < some.size
        np.testing.assert_array_equal(
            numbers[stage].values(states, *given(forward)), np.where(some, every, 0), strict=True
        )
        found = numbers[stage].slopes(states, *given(forward))
        np.testing.assert_allclose(found, np.where(some[:, None], slopes, 0), atol=1e-9)
    see = of_fields(problem, "mujoco", lambda state: state.sensor("speed") + state.sensor("angle"))
    np.testing.assert_array_equal(see(jnp.asarray(states[0, 1:17]), CTRL), 0.7 + 0.3)


def test_after_a_burst_nothing_is_seen_and_nothing_left_behind(tmp_path, monkeypatch, capfd):
    """Of its positions, of a control that is no number, or of accelerations, then again: no warning, and no file."""
    monkeypatch.chdir(tmp_path)
    variables = [tog.Controls(2), tog.Start("qvel[6]")]
    see = {"cost": lambda last: last.site("tip")[0] + last.qacc[0] + last.sensor("felt")[0]}
    J = tog.objective(refused(variables=variables, **see), "mujoco")
    for x in (np.full(5, 1e9), np.array([0, 0, 1e12, 1e12, 0]), np.array([0, 0, 0, 0, 1e12]), np.full(5, 1e8)):
        value, slope = jax.value_and_grad(J)(jnp.asarray(x))
        assert np.isnan(value)
        assert np.isnan(slope).all()
    assert np.isfinite(J(np.zeros(5)))
    assert "".join(capfd.readouterr()) == ""
    assert not list(tmp_path.iterdir())


def test_what_is_not_seen_is_one_line():
    problem = refused()
    fields = jnp.asarray(moments(problem)[0, 1:17])
    with pytest.raises(tog.InputError, match=r"^engine mujoco has no mjx.Data: take qacc, .* or engine mjx$"):
        of_fields(problem, "mujoco", lambda state: state.data.xpos)(fields, CTRL)
    for see in (lambda state: state.site("tip")[0], lambda state: state.sensordata[0]):
        with pytest.raises(tog.InputError, match=r"^engine mujoco has first derivatives only"):
            jax.hessian(of_fields(problem, "mujoco", see))(fields, CTRL)
