"""What docstrings say of a gradient exactly at the end of a control's range, at a limit and at a surface."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog

H, MASS, END = 0.01, 2.0, 3.0
BALL = f"""<mujoco><option timestep="{H}" gravity="0 0 0"/>
  <worldbody>
    <geom type="plane" size="1 1 1" contype="2" conaffinity="2"/>
    <body pos="0 0 0.1"><joint name="z" type="slide" axis="0 0 1" limited="true" range="-1 0.5"/>
      <geom size="0.1" mass="{MASS}" contype="2" conaffinity="2"/></body>
  </worldbody>
  <actuator><motor joint="z" ctrllimited="true" ctrlrange="-1 {END}"/></actuator></mujoco>"""
FREE = (H / MASS, 0.0, 1.0)
VARIABLES = [tog.Controls(), tog.Start("qpos"), tog.Start("qvel")]
"""x [3]: the control, the height over the floor and the speed; J is the speed after one step."""
ENDS = {"within": [END - 0.1, 0.2, 0.0], "at the end": [END, 0.2, 0.0], "beyond": [END + 0.1, 0.2, 0.0]}
SURFACES = {"the floor, at rest": [0.0, 0.0, 0.0], "a limit, at rest": [0.0, 0.5, 0.0], "a limit, hit": [0.0, 0.5, 1.0]}


@pytest.fixture(scope="module")
def gradients():
    model = mujoco.MjModel.from_xml_string(BALL)
    problem = tog.Problem(model, 1, VARIABLES, cost=lambda last: last.qvel[0], bounds=(-9, 9))
    points = jnp.array([*ENDS.values(), *SURFACES.values(), [0.0, -1e-5, 0.0], [0.0, 0.5 + 1e-5, 0.0]])
    return {
        engine: np.asarray(jax.jit(jax.vmap(jax.jacfwd(tog.objective(problem, engine))))(points))
        for engine in ("mjx", "mujoco")
    }


def test_of_a_control_at_the_end_of_its_range_half_the_slope_on_mjx_and_that_within_on_c(gradients):
    slope = H / MASS
    np.testing.assert_allclose(gradients["mjx"][:3, 0], [slope, slope / 2, 0], rtol=1e-9)
    np.testing.assert_allclose(gradients["mujoco"][:3, 0], [slope, slope, 0], rtol=1e-6)


def test_at_a_surface_that_of_the_free_side_on_mjx_and_the_mean_of_both_or_the_side_before_a_jump_on_c(gradients):
    np.testing.assert_allclose(gradients["mjx"][3:6], [FREE] * 3, rtol=1e-9)
    behind = gradients["mujoco"][6:, 1]
    assert (behind < -1).all()
    np.testing.assert_allclose(gradients["mujoco"][3:5, 1], behind / 2, rtol=0.01)
    np.testing.assert_allclose(gradients["mujoco"][5], FREE, rtol=1e-6)
