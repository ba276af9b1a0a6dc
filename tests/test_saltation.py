"""The jumps of touch-downs on MJX: the same in both modes, batched or not, with checkpoints, in float32; and finite."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly, step_function
from tog_mjx.stepping._mjx import make_data, put_model
from tog_mjx.stepping.implicit import STEPS
from tog_mjx.stepping.touch import KICKS

ROOT = Path(__file__).parent.parent
SALTATION = "saltation"
LANDING = """<mujoco><option timestep="0.002" tolerance="1e-12" iterations="50" ls_iterations="50"/>
  <worldbody><geom type="plane" size="5 5 1"/>
  <body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <geom size="0.1" mass="1" condim="1"/></body>
  <body pos="9 0 1"><joint axis="0 1 0" range="-90 0" limited="true"/><geom size="0.1" pos="0.3 0 0" mass="1"
    contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
START, SPEED = np.array([0.0, 0.105, -0.013]), np.array([2.0, -1.0, 3.0])
"""A ball lands, a hinge meets its limit: within five steps."""


def end_of(model: mujoco.MjModel, steps: int, **options):
    """Positions and velocities [2 nv] after a motion, as a function of those at its start."""
    mjx_model = put_model(model)
    data = make_data(mjx_model)

    def end(start):
        qpos, qvel = jnp.split(start, 2)
        after, _ = tog.simulate(
            mjx_model, data.replace(qpos=qpos, qvel=qvel), jnp.zeros(0), steps, differentiation=SALTATION, **options
        )
        return jnp.concatenate([after.qpos, after.qvel])

    return end


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(LANDING)


@pytest.fixture(scope="module")
def starts() -> np.ndarray:
    """Three phases of the time grid."""
    return np.stack([np.concatenate([START + shift * SPEED, SPEED]) for shift in (0, 7e-4, 1.4e-3)])


@pytest.fixture(scope="module")
def forward(model, starts):
    """Values [3, 6] and Jacobians [3, 6, 6] in forward mode, one start after the other."""
    end = end_of(model, 12)

    @compile_quickly
    def both(start):
        value, along = jax.linearize(end, start)
        return value, jax.vmap(along, out_axes=1)(jnp.eye(len(start)))

    return tuple(map(np.stack, zip(*(both(jnp.array(start)) for start in starts), strict=True)))


def test_there_are_jumps(model, starts, forward):
    """Else the tests below would compare nothing."""
    start, h = starts[0], 1e-7

    def in_c(start):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(start, 2)
        mujoco.mj_step(model, data, 12)
        return np.concatenate([data.qpos, data.qvel])

    values, jacobians = forward
    np.testing.assert_allclose(values, [in_c(some) for some in starts], rtol=0, atol=1e-9)
    between = np.stack([(in_c(start + h * e) - in_c(start - h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    apart = np.abs(jacobians[0] - between)
    # The speeds after the touch by the positions before it.
    assert (apart[[4, 5], [1, 2]] > 0.5).all(), apart


def test_a_batch_in_reverse_mode_with_checkpoints_has_the_same(model, starts, forward):
    end = end_of(model, 12, checkpoint=4)
    values, jacobians = compile_quickly(jax.vmap(lambda start: (end(start), jax.jacrev(end)(start))))(jnp.array(starts))
    np.testing.assert_allclose(values, forward[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(jacobians, forward[1], rtol=1e-8, atol=1e-8 * np.abs(forward[1]).max())


def test_in_float32_it_is_the_same_to_its_digits(model, starts, forward):
    with jax.enable_x64(False):
        end = end_of(model, 12)
        both = compile_quickly(jax.vmap(lambda start: (end(start), jax.jacfwd(end)(start))))
        value, jacobian = both(jnp.array(starts, jnp.float32))
    assert value.dtype == jacobian.dtype == jnp.float32
    np.testing.assert_allclose(value, forward[0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(jacobian, forward[1], rtol=0, atol=1e-3 * np.abs(forward[1]).max())


STATES = {
    "at rest at the surface": (0.0, 0.0),
    "at rest above it": (0.125, 0.0),
    "at rest below it": (-0.0009765625, 0.0),
    "at the surface, at speed": (0.0, -1.0),
    "parting at the surface": (0.0, 1.0),
    "in the box": (0.0009765625, -1.0),
    "deep": (-0.0625, -1.0),
}
"""Gap [m] and speed [m/s] of both the ball and the hinge."""
MARGINS = {"none": (0.0, 0.0), "negative": (-0.0078125, 0.0), "gap": (0.0, 0.03), "both": (0.015625, 0.0078125)}
"""Numbers that add up without rounding, else what lies at the surface may lie on either side of it."""


def test_margins_move_the_surface_and_nothing_is_not_a_number():
    """A batch of models and of states: as far from the surface that a margin makes, all is the same."""
    model = mujoco.MjModel.from_xml_string(LANDING.replace('size="0.1" mass="1"', 'size="0.125" mass="1"'))
    mjx_model = put_model(model)
    data = make_data(mjx_model)

    def after(margin, gap, state):
        marked = mjx_model.replace(geom_margin=jnp.zeros(3).at[0].set(margin), geom_gap=jnp.full(3, gap))
        qpos = jnp.array([0.0, 0.125 + margin + state[0], -state[0]])
        qvel = jnp.array([0.0, state[1], -state[1]])
        return tog.step(marked, data.replace(qpos=qpos, qvel=qvel), differentiation=SALTATION).qvel

    of_states = jax.vmap(lambda m, g, s: (after(m, g, s), jax.jacfwd(after, 2)(m, g, s)), (None, None, 0))
    batch = compile_quickly(jax.vmap(of_states, (0, 0, None)))
    margins, gaps = map(jnp.array, zip(*MARGINS.values(), strict=True))
    values, slopes = map(np.asarray, batch(margins, gaps, jnp.array(list(STATES.values()))))
    assert np.isfinite(values).all()
    assert np.isfinite(slopes).all()
    for found in (values, slopes):
        np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=1e-7, atol=1e-7)
    jumps = dict(zip(STATES, slopes[0, :, 1:, 0] * model.opt.timestep, strict=True))
    # All that is at rest at the surface moves as on a spring: the kick over a box of so many kicks.
    np.testing.assert_allclose(jumps["at rest at the surface"], [-1 / KICKS, 1 / KICKS], rtol=1e-6)
    np.testing.assert_array_equal(jumps["parting at the surface"], 0.0)  # Dampers do not hold what parts.


@pytest.mark.parametrize("file", ["equalities.xml", "sliding_block.xml"])
def test_where_nothing_touches_anew_it_is_the_implicit_gradient(file):
    model = mujoco.MjModel.from_xml_path(str(ROOT / "tests" / "scenes" / file))
    function = step_function(model, parameters=False)
    dx = jnp.asarray(np.random.default_rng(0).normal(size=function.x.size))

    def along(how):
        after = functools.partial(function.after, STEPS[how])
        return compile_quickly(lambda x: jax.jvp(after, (x,), (dx,)))(function.x)

    (value, slope), (same, expected) = along(SALTATION), along("implicit")
    np.testing.assert_array_equal(value, same)
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


HELD = """<mujoco><option timestep="0.002" tolerance="1e-14" iterations="50" ls_iterations="50"/><worldbody>
  <geom type="plane" size="5 5 1" friction="0.5"/>
  <body pos="0 0 0.0995"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <geom size="0.1" mass="1" friction="0.5" contype="3" conaffinity="3"/></body>
  <body pos="-0.2 0 0.0995"><joint type="slide" axis="1 0 0"/>
    <geom size="0.1" mass="1" condim="1" priority="1" contype="2" conaffinity="2"/></body></worldbody></mujoco>"""


def test_a_hit_makes_slide_what_the_floor_held():
    """The jump is that of the motion: by its derivative the floor's friction would grow without bound."""
    model = mujoco.MjModel.from_xml_string(HELD)
    mjx_model = put_model(model)
    start, speed, width = make_data(mjx_model), 1.0, model.opt.timestep

    def in_c(position):
        data = mujoco.MjData(model)
        data.qpos[2], data.qvel[2] = position, speed
        mujoco.mj_step(model, data)
        return data.qvel.copy()

    def after(position):
        data = start.replace(qpos=jnp.array([0.0, 0.0, position]), qvel=jnp.array([0.0, 0.0, speed]))
        return tog.step(mjx_model, data, differentiation=SALTATION).qvel

    jump = in_c(1e-9) - in_c(-1e-9)
    assert jump[0] > 0.05
    slopes = compile_quickly(lambda position: jax.jvp(after, (position,), (1.0,))[1])
    for position in (-0.05 * width, 0.05 * width):
        between = (in_c(position + 1e-6) - in_c(position - 1e-6)) / 2e-6
        np.testing.assert_allclose(slopes(position) - between, jump / width, rtol=0.02, atol=1e-3 * jump[0] / width)
