"""Scenes of one feature each: `tog.step` has the value of `mjx.step` and the derivative of its differences.

The derivative is in state, controls and every parameter of the model; see `tog_mjx.checks.step_check`.
"""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import (
    TOLERANCE,
    Verdict,
    column_errors,
    compile_quickly,
    judge,
    reference,
    step_function,
)
from tog_mjx.stepping import implicit
from tog_mjx.stepping._mjx import mjx

SCENES = sorted((Path(__file__).parent / "scenes").glob("*.xml"))


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(Path(__file__).parent / "scenes" / f"{name}.xml"))


@functools.cache
def differences(name: str) -> tuple[np.ndarray, np.ndarray]:
    return reference(step_function(load(name)))


@pytest.mark.parametrize("name", [path.stem for path in SCENES])
def test_the_value_is_mjxs_and_the_derivative_is_that_of_differences(name):
    function = step_function(load(name))
    value, expected = differences(name)
    random = np.random.default_rng(0).normal(size=function.x.size)

    @compile_quickly
    def differentiate(x, direction):
        # Forward mode, and reverse mode as JAX makes it of that: its transpose.
        found, push = jax.linearize(functools.partial(function.after, tog.step), x)
        pull = jax.linear_transpose(push, x)
        return found, jax.vmap(lambda row: pull(row)[0])(jnp.eye(found.size)), push(direction)

    found, reverse, forward = map(np.asarray, differentiate(function.x, random))
    np.testing.assert_allclose(found, value, rtol=0, atol=1e-12)
    assert column_errors(reverse, expected).max() <= TOLERANCE
    along = reverse @ random
    np.testing.assert_allclose(forward, along, rtol=1e-9, atol=1e-9 * np.abs(along).max())


# RK4 is the integrator whose steps are ours; contacts are what a solver in single precision finds hardest.
@pytest.mark.parametrize("name", ["friction_loss", "bouncing_sphere"])
def test_in_single_precision_the_value_is_mjxs(name):
    with jax.enable_x64(False):
        function = step_function(load(name))
        ours, theirs = (compile_quickly(lambda x, s=s: function.after(s, x))(function.x) for s in (tog.step, mjx.step))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


def test_what_stock_mjx_makes_of_rotation_at_rest_and_of_reverse_mode():
    model, (_, expected) = load("collision"), differences("collision")
    stock = judge(model, "native, forward", expected)
    assert stock.word == "wrong"
    assert (stock.error or 0) > 1e-4
    assert judge(model, "native, reverse", expected) == Verdict("error")


def test_mass_moves_no_inverse_weight_but_both_together_are_the_recompiled_model():
    xml = """<mujoco><option timestep="0.002" tolerance="1e-14" iterations="100" ls_iterations="50"/><worldbody>
      <geom type="plane" size="1 1 1"/><body pos="0 0 0.099"><joint type="slide" axis="0 0 1"/>
      <geom size="0.1" mass="{}"/></body></worldbody></mujoco>"""
    mass = 2.0

    def compiled(mass: float) -> mjx.Model:
        return mjx.put_model(mujoco.MjModel.from_xml_string(xml.format(mass)))

    @compile_quickly
    @functools.partial(jax.value_and_grad, allow_int=True)
    def speed(model: mjx.Model) -> jax.Array:
        return tog.step(model, mjx.make_data(model).replace(qvel=jnp.array([-0.5]))).qvel[0]

    h = 1e-4
    recompiled = (speed(compiled(mass + h))[0] - speed(compiled(mass - h))[0]) / (2 * h)
    _, gradient = speed(compiled(mass))
    of_mass, of_weight = gradient.body_mass[1], gradient.body_invweight0[1, 0]
    assert abs(of_mass - recompiled) > 0.1 * abs(of_mass)
    np.testing.assert_allclose(of_mass - of_weight / mass**2, recompiled, rtol=1e-6, atol=1e-9)


def test_the_spring_of_a_tendon_at_its_rest_length_has_its_derivative():
    """Where every model is that nobody has deflected; stock MJX's derivative is zero there."""
    xml = """<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1" pos="0.3 0 0"/></body></worldbody>
      <tendon><fixed stiffness="5" {}><joint joint="hinge" coef="2"/></fixed></tendon></mujoco>"""

    def compiled(forward):
        @compile_quickly
        def slope(model: mjx.Model) -> tuple[jax.Array, jax.Array]:
            def force(angle):
                return forward(model, mjx.make_data(model).replace(qpos=angle[None])).qfrc_passive[0]

            return jax.jvp(force, (0.0,), (1.0,))

        return slope

    def slope(compiled, spring: str) -> float:
        model = mujoco.MjModel.from_xml_string(xml.format(spring))
        force, found = map(float, compiled(mjx.put_model(model, impl="jax")))
        assert force == 0
        return found

    stock, ours = compiled(mjx.forward), compiled(implicit.forward)
    assert slope(stock, "") == 0
    assert slope(ours, "") == slope(ours, 'springlength="0"') == -20
    assert slope(ours, 'springlength="-0.1 0.1"') == 0  # In the middle of a dead band.
