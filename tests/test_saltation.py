"""The jumps of touch-downs on MJX: the same in both modes, batched or not, with checkpoints, in float32; and finite."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx._mjx import make_data, put_model
from tog_mjx.step_check import compile_quickly

ROOT = Path(__file__).parent.parent
SALTATION = "saltation"
LIMITED = """<mujoco><option timestep="0.002" cone="{cone}" tolerance="1e-12" iterations="50" ls_iterations="50"/>
  <worldbody><geom type="plane" size="5 5 1"/>
  <body><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
    <geom size="0.1" mass="1"/></body>
  <body pos="9 0 1"><joint axis="0 1 0" range="-90 0" limited="true"/><geom size="0.1" pos="0.3 0 0" mass="1"
    contype="0" conaffinity="0"/></body></worldbody>
  <tendon><fixed limited="true" range="-9 0.3"><joint joint="x" coef="1"/></fixed></tendon></mujoco>"""
START, SPEED = np.array([0.289, 0.105, 0.0, -0.013]), np.array([2.0, -1.0, 0.0, 3.0])
"""A ball lands, a hinge and a tendon meet their limits: within ten steps of 2 ms each."""


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
    return mujoco.MjModel.from_xml_string(LIMITED.format(cone="elliptic"))


@pytest.fixture(scope="module")
def starts() -> np.ndarray:
    """Three phases of the time grid."""
    return np.stack([np.concatenate([START + shift * SPEED, SPEED]) for shift in (0, 7e-4, 1.4e-3)])


@pytest.fixture(scope="module")
def forward(model, starts):
    """Values [3, 8] and Jacobians [3, 8, 8] in forward mode, one start after the other."""
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
    between = np.stack([(in_c(start + h * e) - in_c(start - h * e)) / (2 * h) for e in np.eye(8)], axis=1)
    apart = np.abs(jacobians[0] - between)
    # The speeds after the touch by the positions before it: of the ball, and of what meets its limit.
    assert (apart[[4, 5, 7], [0, 1, 3]] > 0.5).all()
    # What does not move the touch knows of no jump.
    np.testing.assert_allclose(jacobians[0][7, 6], between[7, 6], atol=1e-5)


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
