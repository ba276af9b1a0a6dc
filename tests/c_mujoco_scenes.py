"""Scenes of the tests of C MuJoCo as an engine, and what its motions and gradients are held against."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import tog_mjx as tog
from tog_mjx.stepping.mjx_state import copy_of

# A free body that turns, a ball joint on a hinge, and an actuator with an activation; nothing touches.
BODIES = """
<mujoco model="bodies">
  <option timestep="0.01" integrator="{integrator}"/>
  <worldbody>
    <body name="free" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="1"/>
      <site name="tip" pos="0.1 0 0.3"/></body>
    <body pos="2 0 1"><joint name="hinge" axis="0 1 0" damping="0.1"/><geom size="0.05" pos="0.3 0 0" mass="0.5"/>
      <body pos="0.6 0 0"><joint type="ball" stiffness="2" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.04" mass="0.3"/></body></body>
  </worldbody>
  <actuator>
    <motor site="tip" gear="1 0.5 0 0 0.3 0.2"/>
    <general joint="hinge" dyntype="filter" dynprm="0.05" gainprm="2"/>
  </actuator>
</mujoco>"""
# A ball that rolls on a floor, pressed into it, and pushed; `{options}` of the solver.
FLOOR = """
<mujoco model="floor">
  <option timestep="0.005" {options}/>
  <worldbody><geom type="plane" size="5 5 0.1" solref="0.05 1"/>
    <body pos="0 0 0.099">{joints}<geom size="0.1" mass="1" solref="0.05 1"/></body>
    {more}
  </worldbody>
  <actuator><motor joint="x"/><motor joint="z"/></actuator>
</mujoco>"""
PLANAR = """<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="roll" axis="0 1 0"/>"""
STEPS = 20


def distance(last: tog.State) -> jax.Array:
    return jnp.sum((last.qpos - 0.3) ** 2) + jnp.sum(last.qvel * jnp.arange(last.qvel.size)) + last.act.sum()


def speeds(state: tog.State) -> jax.Array:
    return state.qvel @ state.qvel + state.ctrl @ state.ctrl * state.time


@functools.cache
def bodies() -> tog.Problem:
    model = mujoco.MjModel.from_xml_string(BODIES.format(integrator="implicitfast"))
    kinds = [tog.Controls(knots=3), tog.Start("qpos"), tog.Start("qvel"), tog.Start("act")]
    return tog.Problem(model, STEPS, kinds, cost=distance, running_cost=speeds)


def somewhere(problem: tog.Problem) -> np.ndarray:
    return np.random.default_rng(0).normal(size=len(problem.x0)) * 0.5


def floor(options: str = "", joints: str = PLANAR, more: str = "", **of) -> tog.Problem:
    model = mujoco.MjModel.from_xml_string(FLOOR.format(options=options, joints=joints, more=more))
    return tog.Problem(model, **{"steps": STEPS, "variables": tog.Controls(2), "cost": distance, **of})


def by_hand(problem: tog.Problem, start: dict, controls) -> mujoco.MjData:
    """The data after a loop over `mj_step` under `controls(data, step)`."""
    data = copy_of(problem.scene.model, problem.origin, **start)
    for step in range(problem.steps):
        data.ctrl[:] = controls(data, step)
        mujoco.mj_step(problem.scene.model, data)
    return data


def differences(J, x: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """The gradient, by central differences of whole motions, all at once."""
    ahead, behind = (jax.vmap(J)(jnp.asarray(x + sign * step * np.eye(len(x)))) for sign in (1, -1))
    return np.asarray(ahead - behind) / (2 * step)


def in_both_modes(J, x) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(jax.jit(jax.grad(J))(jnp.asarray(x))), np.asarray(jax.jit(jax.jacfwd(J))(jnp.asarray(x)))
