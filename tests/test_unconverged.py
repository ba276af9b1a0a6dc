"""Solvers that stop early, as those of the models of reinforcement learning do: the derivative is that of the value."""

import collections
import functools
import re
import warnings

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.stepping._mjx import make_data, mjx, put_model
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.mjx_state import copy_of, default_start, on_mjx, state_of

# A ball between the floor, two limits and a dry friction: two iterations do not do. The other ball is not touched: at
# such a contact stock MJX on the elliptic cone has the derivative NaN.
PRESSED = """<mujoco>
  <option timestep="0.005" iterations="{iterations}" ls_iterations="4" cone="{cone}" solver="{solver}"/>
  <worldbody><geom type="plane" size="1 1 0.1" friction="0.6"/>
    <geom type="sphere" size="0.1" pos="0 0.9 0.1"/>
    <body pos="0.105 0.02 0.095"><joint name="x" type="slide" axis="1 0 0" frictionloss="0.5" range="-0.2 0.001"/>
      <joint name="y" type="slide" axis="0 1 0.3" range="-0.001 1"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.1" mass="1" friction="0.4"/></body></worldbody>
  <actuator><motor joint="x"/><motor joint="y"/><motor joint="z"/></actuator>
  <keyframe><key qvel="0.8 -0.3 -0.5" ctrl="6 -3 -9"/></keyframe></mujoco>"""
# All that has a derivative of ours: a contact, a spring that turns, a tendon's spring at its rest length.
AT_REST = """<mujoco><option iterations="{iterations}"/><worldbody><geom type="plane" size="1 1 0.1"/>
  <body pos="0 0 0.09"><joint name="turn" type="ball" stiffness="2"/><geom size="0.1"/>
    <body pos="0.3 0 0.5"><joint name="slide" type="slide"/><geom size="0.1" contype="0" conaffinity="0"/></body></body>
  </worldbody><tendon><fixed stiffness="3"><joint joint="slide" coef="1"/></fixed></tendon></mujoco>"""
TIMES = 4


def pressed(cone: str, solver: str, iterations: int):
    """The motion [6] of the ball by how far its controls move, as a function of (step, t)."""
    source = mujoco.MjModel.from_xml_string(PRESSED.format(cone=cone, solver=solver, iterations=iterations))
    model = put_model(source)
    start = on_mjx(model, default_start(source))
    direction = np.random.default_rng(0).normal(size=(TIMES, source.nu))

    def motion(step, t):
        def advance(state, ctrl):
            return state_of(step(model, start.replace(**state, ctrl=ctrl))), None

        state, _ = jax.lax.scan(advance, state_of(start), start.ctrl + t * jnp.asarray(direction, start.ctrl.dtype))
        return jnp.concatenate([state["qpos"], state["qvel"]])

    return motion


@pytest.mark.parametrize(("cone", "solver"), [("elliptic", "Newton"), ("pyramidal", "CG")])
def test_the_derivative_of_an_early_stop_is_that_of_the_value(cone, solver):
    motion, h = pressed(cone, solver, iterations=2), 1e-5
    weights = jnp.asarray(np.random.default_rng(1).normal(size=6))
    stock, ours = (functools.partial(motion, step) for step in (mjx.step, STEPS["implicit"]))

    @compile_quickly
    def both_modes(t):
        return *jax.jvp(ours, (t,), (jnp.ones_like(t),)), jax.grad(lambda t: weights @ ours(t))(t)

    expected = compile_quickly(jax.vmap(stock))(jnp.array([-h, 0, h]))
    value, forward, reverse = both_modes(jnp.zeros(()))
    differences = (expected[2] - expected[0]) / (2 * h)
    np.testing.assert_allclose(value, expected[1], rtol=1e-11)
    np.testing.assert_allclose(forward, differences, rtol=0, atol=1e-6 * np.abs(differences).max())
    np.testing.assert_allclose(reverse, weights @ forward, rtol=1e-9)


def test_a_batch_of_early_stops_is_differentiated_in_reverse_mode():
    """As environments of reinforcement learning are: many starts at once."""
    source = mujoco.MjModel.from_xml_string(PRESSED.format(cone="pyramidal", solver="Newton", iterations=1))
    model = put_model(source)
    start = on_mjx(model, default_start(source))
    weights = jnp.asarray(np.random.default_rng(2).normal(size=(2, 3)))
    ctrl, h = start.ctrl + jnp.array([[0.0, 0, 0], [-3, 1, 2]]), 1e-5

    def speed(step, ctrl):
        return (weights * jax.vmap(lambda ctrl: step(model, start.replace(ctrl=ctrl)).qvel)(ctrl)).sum()

    @compile_quickly
    def stock(ctrls):
        return jax.vmap(functools.partial(speed, mjx.step))(ctrls)

    found = compile_quickly(jax.grad(functools.partial(speed, tog.step)))(ctrl)
    moves = h * jnp.eye(ctrl.size).reshape(-1, *ctrl.shape)
    ahead, behind = jnp.split(stock(jnp.concatenate([ctrl + moves, ctrl - moves])), 2)
    np.testing.assert_allclose(found.ravel(), (ahead - behind) / (2 * h), rtol=0, atol=1e-8)
    assert (np.abs(found) > 1e-5).all()


def test_the_converged_model_moves_as_its_solution_does():
    """Newton's steps in C MuJoCo with all the iterations it may want, and nothing of MJX."""
    source = mujoco.MjModel.from_xml_string(PRESSED.format(cone="pyramidal", solver="CG", iterations=2))
    model, exact = put_model(source), tog.converged(source)
    assert (source.opt.solver, source.opt.iterations) == (mujoco.mjtSolver.mjSOL_CG, 2)
    start = default_start(source)
    paths = {}
    for name, some in (("given", source), ("exact", exact)):
        state, path = copy_of(some, start), []
        for _ in range(TIMES):
            mujoco.mj_step(some, state)
            path.append(state.qpos.copy())
        paths[name] = np.array(path)
    data = on_mjx(model, start)
    _, (moved, _) = tog.simulate(tog.converged(model), data, data.ctrl, TIMES)
    np.testing.assert_allclose(moved, paths["exact"], rtol=0, atol=1e-10)
    error = tog.solver_error(model, data, data.ctrl, TIMES)
    _, (given, _) = tog.simulate(model, data, data.ctrl, TIMES)
    np.testing.assert_allclose(error, np.abs(given - paths["exact"]).max(0), rtol=1e-6)
    assert error.max() > 1e-5
    assert tog.solver_error(tog.converged(model), data, data.ctrl, TIMES).max() == 0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"opt.ls_iterations": 2}, "ls_iterations=2"),
        ({"opt.tolerance": 1e-3}, "tolerance=0.001"),
        ({"opt.iterations": 1, "opt.ls_iterations": 2}, ""),  # Unrolled: right all the same.
        ({}, ""),
    ],
)
def test_who_differentiates_what_may_be_unconverged_is_told(options, told):
    model = put_model(mujoco.MjModel.from_xml_string(PRESSED.format(cone="pyramidal", solver="Newton", iterations=50)))
    model = model.tree_replace({"opt.ls_iterations": 50, **options})
    data = make_data(model)

    def velocity(ctrl):
        return tog.step(model, data.replace(ctrl=ctrl)).qvel[0]

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jax.eval_shape(velocity, data.ctrl)
        assert not caught
        jax.eval_shape(jax.grad(velocity), data.ctrl)
    assert len(caught) == bool(told)
    for warning in caught:
        assert told in str(warning.message)
        assert str(warning.message).endswith("simulate tog_mjx.converged(model)")


@pytest.mark.parametrize("iterations", [1, 100])
def test_a_step_that_is_not_differentiated_is_the_program_of_stock_mjx(iterations):
    model = put_model(mujoco.MjModel.from_xml_string(AT_REST.format(iterations=iterations)))
    data = make_data(model)
    stock, ours = (
        compile_quickly(functools.partial(step, model)).lower(data).compile() for step in (mjx.step, tog.step)
    )
    counts = [collections.Counter(re.findall(r"= \S+ ([a-z-]+)\(", some.as_text() or "")) for some in (stock, ours)]
    for count in counts:
        del count["parameter"]  # Of arguments that nothing reads.
    assert counts[0] == counts[1]
    assert counts[0].total() > 100
