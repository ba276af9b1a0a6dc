"""The recipes of scripts/examples for users of other packages: their gradients are their values', and they learn."""

import importlib
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.stepping._mjx import mjx

EXAMPLES = Path(__file__).parent.parent / "scripts" / "examples"
H = 1e-5


@pytest.fixture
def recipe(monkeypatch):
    """A recipe by its name, as a module."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module


def test_the_loop_is_that_of_c_mujoco_through_falls_and_new_episodes(recipe):
    loop = recipe("gymnax_loop")
    reset = jax.jit(loop.reset)

    def in_c(gains, keys, steps=150):
        """The mean reward of a step, and after how many steps episodes end."""
        data, rewards, ends = mujoco.MjData(loop.MODEL), [], []
        for state in map(reset, keys):
            for _ in range(steps):
                if state is not None:
                    mujoco.mj_resetData(loop.MODEL, data)
                    data.qpos[:], data.qvel[:], key, state, age = state.data.qpos, state.data.qvel, state.key, None, 0
                data.ctrl[:] = np.tanh(gains @ [*data.qpos[[0, 2]], *data.qvel[[0, 2]]])
                mujoco.mj_step(loop.MODEL, data)
                age += 1
                rewards.append(1 - (data.qpos[2] / loop.LIMIT) ** 2 - 0.1 * data.ctrl @ data.ctrl)
                if abs(data.qpos[2]) > loop.LIMIT or age == loop.EPISODE:
                    ends.append(age)
                    state = reset(key)
        return np.mean(rewards), ends

    keys, gains = jax.random.split(jax.random.key(0), 8), np.array([0.1, 0.25, 0.0, 0.0])
    expected, ends = in_c(gains, keys)
    assert loop.EPISODE in ends
    assert min(ends) < loop.EPISODE
    moves = H * np.eye(gains.size)
    differences = [(in_c(gains + move, keys)[0] - in_c(gains - move, keys)[0]) / (2 * H) for move in moves]
    value, gradient = loop.mean_reward(gains, keys)
    np.testing.assert_allclose(value, expected, rtol=1e-9)
    np.testing.assert_allclose(gradient, differences, rtol=0, atol=1e-6 * np.abs(differences).max())

    before, after = loop.main(updates=15)
    assert before < 0.86
    assert after > 0.99


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="torch is not installed: pip install torch")


def test_torch_has_the_value_and_the_gradient_in_the_tensors_own_precision(torch, recipe):
    module = recipe("torch_function")
    problem = recipe("push").push()
    J = tog.objective(problem, "mujoco")
    of_tensor = module.tensor_function(J)
    x = np.array([0.3, 0.01, 0.3, 0.02, 0.4, 0.03])  # No touch-down moves by a step within H.
    differences = [(float(J(x + H * row)) - float(J(x - H * row))) / (2 * H) for row in np.eye(6)]

    # A strided tensor, two of two precisions, one that wants no gradient, and second derivatives.
    strided = torch.tensor(x).repeat_interleave(2)[::2].requires_grad_()
    along = torch.tensor(x[::2], dtype=torch.float32, requires_grad=True)
    across = torch.tensor(x[1::2], requires_grad=True)
    cost = of_tensor(strided)
    (2 * cost).backward()
    np.testing.assert_allclose(cost.detach(), J(x), rtol=1e-12)
    np.testing.assert_allclose(strided.grad, 2 * np.array(differences), rtol=0, atol=1e-6 * np.abs(differences).max())
    of_tensor(torch.stack([along, across], 1).flatten()).backward()
    assert (along.grad.dtype, across.grad.dtype) == (torch.float32, torch.float64)
    np.testing.assert_allclose(along.grad, differences[::2], rtol=1e-3)
    np.testing.assert_allclose(across.grad, differences[1::2], rtol=1e-3)
    still = of_tensor(torch.tensor(x, dtype=torch.float32))
    assert (still.dtype, still.requires_grad) == (torch.float32, False)

    (slope,) = torch.autograd.grad(of_tensor(strided) ** 2, strided, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


@pytest.mark.usefixtures("torch")
def test_torch_learns(recipe):
    before, after = recipe("torch_function").main(updates=20)
    np.testing.assert_allclose(before, 0.1765, atol=1e-4)
    assert after < 0.02


@pytest.fixture
def playground(recipe, monkeypatch):
    pytest.importorskip("mujoco_playground", reason="playground is not installed: pip install '.[clients]'")
    monkeypatch.setattr(mjx, "step", mjx.step)  # Theirs comes back afterwards.
    reward = importlib.import_module("mujoco_playground._src.reward")
    monkeypatch.setattr(reward, "tolerance", reward.tolerance)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of theirs.
        yield recipe("playground_policy")


def test_playgrounds_policy_learns_by_the_gradient_of_its_stock_return(playground):
    stock = importlib.import_module("mujoco_playground").registry.load(
        "CartpoleBalance", config_overrides={"impl": "jax"}
    )
    starts = compile_quickly(jax.vmap(stock.reset))(jax.random.split(jax.random.key(0), playground.STARTS))
    policy = playground.initial_policy(stock, jax.random.key(2))
    policy["out"] = policy["out"] + 0.3  # Else half of its gradient is zero.
    leaves, tree = jax.tree.flatten(policy)
    generator = np.random.default_rng(3)
    direction = jax.tree.unflatten(tree, [jnp.asarray(generator.normal(size=leaf.shape)) for leaf in leaves])

    def along(environment, t):
        moved = jax.tree.map(lambda leaf, dot: leaf + t * dot, policy, direction)
        return playground.mean_return(environment, moved, starts)

    behind, expected, ahead = compile_quickly(jax.vmap(lambda t: along(stock, t)))(jnp.array([-H, 0, H]))
    environment = playground.differentiable("CartpoleBalance")
    assert mjx.step is tog.step
    value, slope = compile_quickly(jax.value_and_grad(lambda t: along(environment, t)))(jnp.zeros(()))
    np.testing.assert_allclose(value, expected, rtol=1e-10)
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * H), rtol=1e-6)

    before, after = playground.main(updates=40)
    assert before < 99
    assert after > 99.5


def test_playgrounds_reward_has_a_derivative_within_a_bound_that_is_infinite(playground):
    reward = importlib.import_module("mujoco_playground._src.reward")
    stock, x = reward.tolerance, jnp.array([0.9, 1.1, 1.3])
    playground.differentiable("CartpoleBalance")
    how = {"bounds": (1.2, float("inf")), "margin": 0.6}
    np.testing.assert_array_equal(reward.tolerance(x, **how), stock(x, **how))
    slopes = jax.vmap(jax.grad(lambda x: reward.tolerance(x, **how)))(x)
    differences = (stock(x + H, **how) - stock(x - H, **how)) / (2 * H)
    np.testing.assert_allclose(slopes, differences, atol=1e-8)
    assert slopes[-1] == 0
