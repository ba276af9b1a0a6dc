"""A policy for an environment of MuJoCo Playground, trained by the exact gradient of its return.

`python scripts/examples/playground_policy.py` trains a small network on CartpoleBalance, through the environment's own
step and reward, and prints the return of a horizon before and after. Needs `pip install playground`.

Three lines make the environment differentiable: `impl="jax"`, as Warp has no gradients; `mjx.step = tog.step`, for all
environments of this process; and finite bounds for its reward, whose derivative is NaN within an infinite one.
"""

import jax
import jax.numpy as jnp
import optax
from mujoco import mjx
from mujoco_playground import registry
from mujoco_playground._src import reward

import tog_mjx as tog

HORIZON, STARTS, HIDDEN, FAR = 100, 8, 16, 1e6


def differentiable(name):
    """The environment, with `tog.step` for its step and bounds of its reward that are at most `FAR`."""
    stock = reward.tolerance

    def tolerance(x, bounds=(0.0, 0.0), *args, **named):
        return stock(x, tuple(min(max(bound, -FAR), FAR) for bound in bounds), *args, **named)

    mjx.step, reward.tolerance = tog.step, tolerance
    return registry.load(name, config_overrides={"impl": "jax"})


def initial_policy(environment, key):
    inputs, outputs = environment.observation_size, environment.action_size
    return {"w": 0.1 * jax.random.normal(key, (HIDDEN, inputs)), "out": jnp.zeros((outputs, HIDDEN))}


def act(policy, observation):
    return jnp.tanh(policy["out"] @ jnp.tanh(policy["w"] @ observation))


def mean_return(environment, policy, starts):
    """The sum of the rewards over the horizon, averaged over a batch of starts."""

    def advance(state, _):
        state = environment.step(state, act(policy, state.obs))
        return state, state.reward

    return jax.vmap(lambda start: jax.lax.scan(advance, start, length=HORIZON)[1].sum())(starts).mean()


def main(name="CartpoleBalance", updates=60):
    jax.config.update("jax_enable_x64", True)
    environment = differentiable(name)
    starts = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), STARTS))
    policy = initial_policy(environment, jax.random.key(1))
    value_and_gradient = jax.jit(jax.value_and_grad(lambda policy: mean_return(environment, policy, starts)))
    optimizer = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(0.03))
    state, before = optimizer.init(policy), value_and_gradient(policy)[0]
    for _ in range(updates):
        gradient = value_and_gradient(policy)[1]
        change, state = optimizer.update(jax.tree.map(jnp.negative, gradient), state)
        policy = optax.apply_updates(policy, change)
    after = value_and_gradient(policy)[0]
    print(f"{name}: return of {HORIZON} steps {before:.2f} before, {after:.2f} after {updates} updates")
    return before, after


if __name__ == "__main__":
    main()
