"""Second derivatives through `tog.step`: those of differences of the gradient, symmetric, the same in every mode."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import ORDERS, check_second_order, compile_quickly
from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.scene import compile_model
from tog_mjx.stepping import implicit
from tog_mjx.stepping._mjx import put_model
from tog_mjx.stepping.constraints import Rows
from tog_mjx.stepping.mjx_state import default_start, on_mjx

SCENES = Path(__file__).parent / "scenes"
TOLERANCE = 1e-5
"""Relative to the Hessian's largest entry: what differences of the gradient are good for."""

# The upper joint is beyond its limit, the lower one near its own: how the solution moves decides.
PENDULUM = """<mujoco><option timestep="0.005" tolerance="1e-14" iterations="100" ls_iterations="50"/><worldbody>
  <body><joint name="upper" axis="0 1 0" range="-20 20" limited="true"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="1"/>
    <body pos="0 0 -0.5"><joint name="lower" axis="0 1 0" range="-60 60" limited="true"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.5" mass="1"/></body></body></worldbody>
  <actuator><motor joint="upper"/><motor joint="lower"/></actuator>
  <keyframe><key qpos="0.4 1.1" qvel="1.5 0.7" ctrl="0.5 -1"/></keyframe></mujoco>"""


# `scripts/check_step.py --second-order` does all scenes and orders, which takes minutes to compile.
@pytest.mark.parametrize(
    ("scene", "order"),
    list(zip(("collision", "pendulum", "box"), ORDERS, strict=True)),
    ids=lambda x: x.replace(" ", "-"),
)
def test_the_hessian_of_a_step_is_that_of_differences(scene, order):
    is_pendulum = scene == "pendulum"
    model = mujoco.MjModel.from_xml_string(PENDULUM) if is_pendulum else compile_model(SCENES / f"{scene}.xml")
    assert check_second_order(model, (order,))[order] <= TOLERANCE


@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
def test_a_loop_loses_no_second_derivative(outer):
    """JAX drops rules of derivatives from what `scan` computes on the way forward to a reverse pass."""
    random = np.random.default_rng(0)
    jacobian, mixing = jnp.array(random.normal(size=(2, 2, 2)))

    def step(p):
        rows = Rows(
            jacobian * (1 + jnp.sin(p[0])),
            reference=jnp.array([1.0, 2.0]) * jnp.cos(p[1]) + 5,
            D=jnp.exp(p),
            friction_loss=jnp.zeros(2),
            friction=jnp.zeros((0, 5)),
            impratio=jnp.ones(()),
            equalities=0,
            losses=0,
            elliptic=(),
        )
        mass, smooth = jnp.eye(2) + jnp.outer(p, p), mixing @ p
        # Both rows are active: the solution is that of a linear system.
        pull = rows.jacobian.T * rows.D
        solution = jnp.linalg.solve(mass + pull @ rows.jacobian, smooth + pull @ rows.reference)
        held = jax.lax.stop_gradient(solution)
        return p + 0.1 * solution, p + 0.1 * implicit._differentiable(held, mass, smooth, rows)

    def looped(p):
        last, _ = jax.lax.scan(lambda p, _: (step(p)[1], None), p, length=3)
        return last @ jnp.array([1.0, 2.0])

    def unrolled(p):
        for _ in range(3):
            p = step(p)[0]
        return p @ jnp.array([1.0, 2.0])

    p = jnp.array([0.3, -0.4])
    expected = jax.hessian(unrolled)(p)
    assert jnp.abs(expected).min() > 0.1
    np.testing.assert_allclose(outer(jax.grad(looped))(p), expected, rtol=1e-10)


# Hinged out of its centre, and beyond its limit.
FLAP = """<mujoco><option timestep="0.005" tolerance="1e-14" iterations="1" ls_iterations="6"/><worldbody>
  <body><joint name="flap" axis="0 1 0" range="-20 20"/><geom size="0.02" pos="0.3 0 -0.5" mass="1"/></body></worldbody>
  <actuator><motor joint="flap"/></actuator><keyframe><key qpos="0.4" qvel="1.5"/></keyframe></mujoco>"""


def test_the_hessian_through_three_steps_is_that_of_differences():
    """Of a solver whose iteration is differentiated; rules of one that has converged are tested above."""
    source = mujoco.MjModel.from_xml_string(FLAP)
    model = put_model(source)
    start = on_mjx(model, default_start(source))

    def number(x):
        data, _ = tog.simulate(model, start.replace(qpos=x[:1], qvel=x[1:2]), x[2:], 3)
        return jnp.sin(3 * data.qpos[0]) + data.qvel[0] ** 2

    x, h = jnp.array([0.4, 1.5, 0.7]), 1e-4
    moved = compile_quickly(jax.vmap(jax.jacfwd(number)))(x + h * jnp.concatenate([jnp.eye(3), -jnp.eye(3)]))
    expected = (moved[:3] - moved[3:]) / (2 * h)
    found = compile_quickly(jax.hessian(number))(x)
    np.testing.assert_allclose(found, expected, rtol=1e-5)  # Entry by entry: none is zero.


@jax.custom_jvp
def root(p):
    """q with q + q^3 = p."""
    q = jnp.zeros_like(p)
    for _ in range(60):
        q = q - (q + q**3 - p) / (1 + 3 * q**2)
    return q


def check(rule, *, bend=0.0):
    root.defjvp(rule)

    def total(x):
        return jnp.sum(root(x) ** 2) + jnp.sum(x[0] * x) + bend * jnp.sum(jnp.abs(x) ** 3)

    verdict = tog.check(total, [0.7, -1.3, 2.0], second_order=True)
    (finding,) = [finding for finding in verdict.findings if finding.check == "second order"]
    return finding


def test_a_rule_that_forgets_its_own_answer_is_right_to_first_order_only():
    def forgets(primals, tangents):
        q = jax.lax.stop_gradient(root(*primals))
        return q, tangents[0] / (1 + 3 * q**2)

    def remembers(primals, tangents):
        q = root(*primals)
        return q, tangents[0] / (1 + 3 * q**2)

    found = check(forgets)
    assert found.level == Level.FAULT
    assert found.value > 0.01
    found = check(remembers)
    assert found.level == Level.FINE
    assert found.value < 1e-6


def test_second_derivatives_are_checked_on_demand_only():
    verdict = tog.check(lambda x: x @ x, [1.0, 2.0])
    assert "second order" not in [finding.check for finding in verdict.findings]
