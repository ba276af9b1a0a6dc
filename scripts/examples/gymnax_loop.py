"""A loop in the style of gymnax and brax: reset and step of a scene of one's own, differentiated through contact.

`python scripts/examples/gymnax_loop.py` teaches a pole to balance on its wheel, which rolls on the floor by friction,
by the exact gradient of the mean reward in the policy's gains. It prints that reward before and after, and needs
nothing but tog_mjx.

An episode ends where the pole has fallen, or after `EPISODE` steps; the next one begins at once, from a start that the
state's own key draws. The gradient passes through all of them. Where an episode would end a step earlier the reward
jumps, and of that the gradient knows nothing.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import optax
from mujoco import mjx

import tog_mjx as tog

MODEL = mujoco.MjModel.from_xml_string("""<mujoco> <option timestep="0.01" iterations="50" tolerance="1e-12"/>
  <worldbody> <geom type="plane" size="5 1 1"/>
    <body pos="0 0 0.0995"> <joint type="slide" axis="1 0 0"/> <joint type="slide" axis="0 0 1"/>
      <joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.03" mass="1" contype="0" conaffinity="0"/>
      <body> <joint name="wheel" axis="0 1 0"/> <geom size="0.1" mass="0.5"/> </body> </body> </worldbody>
  <actuator> <motor joint="wheel" gear="3"/> </actuator> </mujoco>""")
LIMIT, EPISODE = 0.5, 100  # rad; steps


class State(NamedTuple):
    data: mjx.Data
    steps: jax.Array
    key: jax.Array


def reset(key):
    key, own = jax.random.split(key)
    tilt, speed = jax.random.uniform(own, (2,), minval=-0.1, maxval=0.1)
    data = mjx.make_data(MODEL, impl="jax")
    return State(data.replace(qpos=data.qpos.at[2].set(tilt), qvel=data.qvel.at[0].set(speed)), jnp.zeros((), int), key)


def step(state, action):
    """The next state, which is a new episode's where this one is done; the reward; and whether it is done."""
    data = tog.step(mjx.put_model(MODEL, impl="jax"), state.data.replace(ctrl=action))
    tilt, steps = data.qpos[2], state.steps + 1
    reward, done = 1 - (tilt / LIMIT) ** 2 - 0.1 * action @ action, (jnp.abs(tilt) > LIMIT) | (steps == EPISODE)
    after = jax.tree.map(lambda new, old: jnp.where(done, new, old), reset(state.key), State(data, steps, state.key))
    return after, reward, done


def policy(gains, data):
    return jnp.tanh(gains @ jnp.array([data.qpos[0], data.qpos[2], data.qvel[0], data.qvel[2]]))[None]


@jax.jit
@jax.value_and_grad
def mean_reward(gains, keys):
    def advance(state, _):
        return step(state, policy(gains, state.data))[:2]

    return jax.vmap(lambda key: jax.lax.scan(advance, reset(key), length=150)[1])(keys).mean()


def main(updates=30):
    jax.config.update("jax_enable_x64", True)
    keys, optimizer, gains = jax.random.split(jax.random.key(0), 8), optax.adam(0.1), jnp.zeros(4)
    state = optimizer.init(gains)
    before = mean_reward(gains, keys)[0]
    for _ in range(updates):
        change, state = optimizer.update(-mean_reward(gains, keys)[1], state)
        gains = optax.apply_updates(gains, change)
    after = mean_reward(gains, keys)[0]
    print(f"mean reward of a step: {before:.3f} before, {after:.4f} after {updates} updates; gains {gains.round(2)}")
    return before, after


if __name__ == "__main__":
    main()
