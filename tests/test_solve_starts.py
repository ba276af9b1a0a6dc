"""Costs of many starts: estimates of their mean's gradient, and which iterate a descent on them takes for the best."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import tog_mjx as tog
from tog_mjx.engines.objective import Objective
from tog_mjx.gradients import common_starts, exact, stochastic, zeroth_order
from tog_mjx.gradients.both_orders import both_orders
from tog_mjx.gradients.mixed import mixed
from tog_mjx.solving import held_out
from tog_mjx.solving.descent import Descent, Status
from tog_mjx.solving.solve import rule_of_many

STEPS, COUNT, SPREAD, SIGMA, SAMPLES = 30, 4, 0.3, 0.02, 4
KEYS, SIGMAS = 400, 5
TARGET = jnp.array([-0.3, 1.8])
AT = jnp.array([-0.4, 1.2])


def miss(last: tog.State) -> jax.Array:
    return jnp.sum((last.qpos[3:5] - TARGET) ** 2)


@pytest.fixture(scope="module")
def aloft() -> mujoco.MjData:
    """The flip's finger in free air, held to its setpoints by springs: where it ends is affine in them and in where it
    starts, so the gradient of the mean cost is that from the mean start."""
    start = mujoco.MjData(tog.load_scene("flip").model)
    start.qpos[:] = tog.Problem("flip", 1, cost=miss).origin.qpos
    start.qpos[3:5] = -0.7, 1.4
    return start


@pytest.fixture(scope="module")
def many(aloft) -> Objective:
    def sample(key: jax.Array) -> dict[str, jax.Array]:
        return {"qpos": jnp.asarray(aloft.qpos).at[3:5].add(SPREAD * jax.random.normal(key, (2,)))}

    return tog.objective(tog.Problem("flip", STEPS, cost=miss, start=tog.Starts(sample, COUNT)), "penalty")


@pytest.fixture(scope="module")
def one(aloft) -> Objective:
    return tog.objective(tog.Problem("flip", STEPS, cost=miss, start=aloft), "penalty")


def orders(objective: Callable, **settings) -> Callable:
    """Half of each of both orders, as an estimator."""

    def estimate(key, u):
        terms = both_orders(objective, **settings)(key, u)
        return terms.cost, (terms.zeroth + terms.first).mean(0) / 2

    return estimate


SAMPLED = {"sigma": SIGMA, "samples": SAMPLES}
ESTIMATORS: dict[str, tuple[Callable, dict]] = {
    "exact": (exact, {}),
    "stochastic": (stochastic, {"sigma": SIGMA, "normalised": True}),
    "zeroth order": (zeroth_order, SAMPLED),
    "both orders": (orders, SAMPLED),
    "mixed": (mixed, SAMPLED),
}


def draw(estimate: Callable) -> np.ndarray:
    """Gradients [KEYS, 2] under as many keys."""
    keys = jax.random.split(jax.random.key(3), KEYS)
    return np.asarray(jax.jit(jax.vmap(estimate, (0, None)))(keys, AT)[1])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_mean_of_an_estimate_is_the_gradient_of_the_mean_cost(many, one, name):
    make, settings = ESTIMATORS[name]
    found = draw(common_starts(make, many, **settings))
    error, expected = found.std(0) / np.sqrt(KEYS), jax.grad(one)(AT)
    assert (error < 0.1 * np.linalg.norm(expected)).all()
    np.testing.assert_array_less(np.abs(found.mean(0) - expected), SIGMAS * error)


def test_common_starts_take_their_noise_out_of_differences(many):
    """With starts of its own for each evaluation the cost's noise is divided by sigma."""
    costs = many.each(AT, jax.random.key(0), 4000)

    def apart(key, u):
        keys = jax.random.split(key, SAMPLES + 2)
        w = SIGMA * jax.random.normal(keys[0], (SAMPLES, 2))
        rises = jax.vmap(many)(u + w, keys[2:]) - many(u, keys[1])
        return rises, (rises[:, None] * w).mean(0) / SIGMA**2

    common, own = (draw(estimate).var(0).sum() for estimate in (common_starts(zeroth_order, many, **SAMPLED), apart))
    # v is the variance of a mean cost: 2 v E |w|^2 / (N sigma^4), half of it from that which is subtracted from all.
    noise = float(costs.var()) / COUNT * 2 * 2 / (SIGMA**2 * SAMPLES)
    np.testing.assert_allclose(own - common, noise, rtol=0.2)
    assert common < own / 20


def test_a_step_falls_as_a_cosine_and_one_spike_does_not_stall_the_rest():
    updates, step, ahead = 10, 0.3, jnp.array([0.6, 0.8])

    def run(spike: float) -> np.ndarray:
        rule, x = rule_of_many(step, updates), jnp.zeros(2)
        memory, moves = rule.init(x), []
        for i in range(updates):
            move, memory = rule.update(ahead * (spike if i == 3 else 1), memory, x)
            moves.append(move)
        return np.array(moves)

    fall = step * (1 + np.cos(np.pi * np.arange(updates) / updates)) / 2
    # Adam moves each variable by its step, under gradients that are always the same.
    np.testing.assert_allclose(run(1.0), -np.outer(fall, [1, 1]), rtol=1e-6)
    np.testing.assert_allclose(run(1e6), run(1.0), rtol=1e-9)


def test_held_out_starts_judge_and_not_the_luck_of_a_draw(many, one):
    budget = 1200
    found = tog.solve(many.problem, budget=budget, engine="penalty")
    assert found.held_out is not None
    judged = np.flatnonzero(np.isfinite(found.held_out))
    np.testing.assert_array_equal(judged, np.linspace(0, found.iterations, 11).round())
    starts = int(budget * held_out.SHARE / 11)
    spent = (found.iterations + 1) * 4 * COUNT + 11 * starts
    assert budget - 4 * COUNT - 11 < spent <= budget
    expected = [many.each(found.setpoints[i], jax.random.key(held_out.KEY), starts).mean() for i in judged]
    np.testing.assert_allclose(found.held_out[judged], expected, rtol=1e-12)
    assert found.best_iteration == judged[np.argmin(expected)]
    np.testing.assert_array_equal(found.best, found.setpoints[found.best_iteration])
    # From the mean start, the cost tells iterates apart without any noise.
    lucky, gap = int(found.costs.argmin()), jax.jit(jax.vmap(one))(found.setpoints)
    assert lucky != found.best_iteration
    assert gap[found.best_iteration] == gap.min() < gap[lucky]


def test_the_share_that_judges_is_part_of_the_least_budget(many):
    told = r"budget is 17: one gradient of flip on penalty takes 16.0 evaluations, beside the 10% of it that judge"
    with pytest.raises(tog.InputError, match=told):
        tog.solve(many.problem, budget=17, engine="penalty")


def test_an_iterate_that_fails_on_held_out_starts_is_not_the_best(many):
    """Its cost there is infinite."""

    def cliff(last: tog.State) -> jax.Array:
        return jnp.where(last.ctrl[0] > 1.5, jnp.nan, -last.ctrl[0])

    J = tog.objective(tog.Problem("flip", 1, cost=cliff, start=many.problem.start), "penalty")
    rows = np.arange(4.0)[:, None] * [1, 0]
    found = held_out.judge(Descent(-rows[:, 0], rows, rows, Status.EXHAUSTED, 0.0, 0.0), J, 44)
    np.testing.assert_array_equal(found.held_out, [0, -1, np.inf, np.inf])
    assert found.best_iteration == 1
    np.testing.assert_array_equal(found.last, [3, 0])
