"""Solvers that stop early, as those of the models of reinforcement learning do: the derivative is that of the value."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tog_mjx._mjx import mjx, put_model
from tog_mjx.implicit import STEPS
from tog_mjx.state import default_start, on_mjx, state_of
from tog_mjx.step_check import compile_quickly

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
