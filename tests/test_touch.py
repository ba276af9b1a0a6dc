"""The jumps of touch-downs in the derivative: against closed forms, C MuJoCo over many phases, and smoothed costs."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.engines import make_simulator
from tog_mjx.engines.objective import final_cost
from tog_mjx.paper.tasks import get_task
from tog_mjx.stepping._mjx import make_data, put_model
from tog_mjx.stepping.touch import KICKS, box_width, switch


@pytest.mark.parametrize(("dt", "within"), [(2e-4, 0.01), (1e-3, 0.03)])
def test_a_bounce_obeys_its_law(dt, within):
    """A mass on a spring and a damper that act below 0 and never pull: it leaves with e times its speed, so that where
    it is in the end moves by -e times where it began."""
    mass, stiffness, damping, speed = 1.0, 1000.0, 20.0, 1.0
    steps = round(0.5 / dt)

    def end(start, has_jumps):
        def advance(state, _):
            x, v = state
            force = jnp.maximum(-stiffness * x - damping * v, 0.0)
            is_touching = switch(x, box_width(v, force / mass, dt)) if has_jumps else jnp.where(x < 0, 1.0, 0.0)
            v = v + dt * is_touching * force / mass
            return (x + dt * v, v), None

        return jax.lax.scan(advance, (start, -speed), None, length=steps)[0][0]

    # 200 phases of the time grid.
    starts = 0.1 + speed * dt * jnp.arange(200) / 200 * 7
    slopes = {flag: jax.jit(jax.vmap(jax.grad(lambda x, f=flag: end(x, f))))(starts) for flag in (True, False)}
    decay = damping / (2 * mass)
    omega = np.sqrt(stiffness / mass - decay**2)
    # It lets go where spring and damper cancel.
    time = (np.pi - np.arctan2(damping * omega, stiffness - damping * decay)) / omega
    restitution = np.exp(-decay * time) * (decay / omega * np.sin(omega * time) - np.cos(omega * time))
    assert abs(slopes[True].mean() / -restitution - 1) <= within
    assert abs(slopes[False].mean() / -restitution - 1) > 0.3
    np.testing.assert_array_equal(end(starts[0], True), end(starts[0], False))


FLIP = get_task("flip")
CHATTERING = (-0.13488983, 0.10549528)
"""A setpoint at which a corner slides and hovers: boxes of entry and of exit alone give a gradient of 3e8 there."""


def test_on_the_flip_it_is_the_slope_of_the_landscape():
    low, high = np.array(FLIP.window).T
    points = np.vstack([CHATTERING, np.random.default_rng(0).uniform(low, high, (15, 2))])
    draws, sigma = np.random.default_rng(1).normal(size=(1024, 2)), 3e-3

    def derivatives(differentiation):
        simulator = make_simulator("penalty", FLIP.scene, differentiation=differentiation)
        value_and_slopes = jax.value_and_grad(lambda u: final_cost(FLIP, simulator, u))
        return map(np.asarray, jax.jit(jax.vmap(value_and_slopes))(jnp.array(points)))

    (values, between), (same, slopes) = derivatives("native"), derivatives("saltation")
    np.testing.assert_array_equal(values, same)
    simulator = make_simulator("penalty", FLIP.scene)
    cost = jax.jit(jax.vmap(lambda u: final_cost(FLIP, simulator, u)))
    ahead, behind = (np.stack([cost(jnp.array(p + sign * sigma * draws)) for p in points]) for sign in (1, -1))
    smoothed = np.einsum("pk,kn->pn", ahead - behind, draws) / (2 * sigma * len(draws))

    def errors(found):
        return np.linalg.norm(found - smoothed, axis=1) / np.linalg.norm(smoothed, axis=1)

    assert np.median(errors(slopes)) <= 0.06  # A third of it is that of the draws.
    assert np.median(errors(between)) >= 0.2
    assert np.linalg.norm(slopes, axis=1)[0] <= 3 * np.linalg.norm(smoothed, axis=1)[0]


LANDING = """<mujoco><option timestep="0.002" cone="{cone}" gravity="0 0 0" tolerance="1e-14" iterations="50"
    ls_iterations="50"/><worldbody>
  <geom type="plane" size="5 5 1"/>
  <body><joint name="z" type="slide" axis="0 0 1"/><joint name="turn" axis="0 1 0"/><inertial pos="0 0 0" mass="1"
    diaginertia="0.25 0.25 0.25"/>
    <geom size="0.1" pos="0.5 0 0" friction="0.5"/><geom size="0.1" pos="-0.5 0 0" friction="0.5"/></body>
  <body pos="9 0 1"><joint name="hinge" axis="0 1 0" range="-90 0" limited="true"/><geom size="0.1" pos="0.3 0 0"
    mass="1" contype="0" conaffinity="0"/></body>
  <body pos="9 9 1"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.1" mass="1" contype="0"
    conaffinity="0"/></body></worldbody>
  <tendon><fixed limited="true" range="-1 0"><joint joint="slide" coef="1"/></fixed></tendon></mujoco>"""


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_what_switches_together_counts_once(cone):
    """Two spheres of one body land flat, beside a joint and a tendon that meet their limits."""
    model = mujoco.MjModel.from_xml_string(LANDING.format(cone=cone))
    dt, speeds = model.opt.timestep, np.array([-1.0, 0.0, 0.8, 0.6])
    at_surface = np.array([0.1, 0.0, 0.0, 0.0])
    inwards = np.array([-1.0, 0.0, 1.0, 1.0])

    def after_in_c(gap):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = at_surface - gap * inwards, speeds
        mujoco.mj_step(model, data)
        return data.qvel.copy()

    jump = after_in_c(-1e-9) - after_in_c(1e-9)
    moving = [0, 2, 3]
    width = np.maximum(np.abs(speeds) * dt, KICKS * np.abs(jump) * dt)
    mjx_model, mjx_data = put_model(model), make_data(put_model(model))

    @compile_quickly
    def slopes(position):
        def after(q):
            return tog.step(
                mjx_model, mjx_data.replace(qpos=q, qvel=jnp.array(speeds)), differentiation="saltation"
            ).qvel

        units, (_, along) = jnp.eye(len(position)), jax.linearize(after, position)
        back = jax.linear_transpose(along, position)
        return jax.vmap(along)(units).T, jax.vmap(lambda row: back(row)[0])(units)

    for side in (-0.4, -0.05, 0.05, 0.4):
        gap = side * width
        found, backward = map(np.asarray, slopes(jnp.array(at_surface - gap * inwards)))
        np.testing.assert_allclose(backward, found, rtol=1e-9, atol=1e-9 * np.abs(found).max())
        between = -(after_in_c(gap + 1e-6) - after_in_c(gap - 1e-6)) * inwards / 2e-6
        expected = jump[moving] * inwards[moving] / width[moving]
        # That of the surface, however deep the bodies are.
        np.testing.assert_allclose((np.diag(found) - between)[moving], expected, rtol=0.02)
    apart = np.asarray(slopes(jnp.array(at_surface - 0.6 * width * inwards))[0])
    np.testing.assert_array_equal(np.diag(apart)[moving], 0.0)


TWO_BALLS = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
  <body><joint type="slide" axis="1 0 0"/><geom size="0.05" mass="1" condim="1"/></body>
  <body pos="0.2 0 0"><joint type="slide" axis="1 0 0"/><geom size="0.05" mass="1" condim="1"/></body></worldbody>
  </mujoco>"""


def test_through_a_collision_it_is_the_slope_over_many_phases():
    model, steps, count = mujoco.MjModel.from_xml_string(TWO_BALLS), 200, 24
    window = np.linspace(-5e-3, 5e-3, count)

    def in_c(shift):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = shift, 1.0
        mujoco.mj_step(model, data, steps)
        return data.qpos[1]

    wide = (in_c(window[-1]) - in_c(window[0])) / (window[-1] - window[0])
    mjx_model, start = put_model(model), make_data(put_model(model))

    def end(shift):
        data = start.replace(qpos=jnp.array([shift, 0.0]), qvel=jnp.array([1.0, 0.0]))
        return tog.simulate(
            mjx_model, data, jnp.zeros(0), steps, differentiation="saltation", observe=lambda data: data.qpos[1]
        )[1][-1]

    slopes = compile_quickly(jax.vmap(lambda shift: jax.jvp(end, (shift,), (1.0,))))
    values, found = map(np.asarray, slopes(jnp.array(window)))
    np.testing.assert_allclose(values, [in_c(shift) for shift in window], rtol=0, atol=1e-6)
    between = np.array([(in_c(shift + 1e-7) - in_c(shift - 1e-7)) / 2e-7 for shift in window])
    error, before = abs(found.mean() - wide), abs(between.mean() - wide)
    assert before > 1
    assert error <= 0.1 * before
