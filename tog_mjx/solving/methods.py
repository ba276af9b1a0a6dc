"""Methods that a study compares: a gradient estimator with an update rule, or an evolution strategy.

A method is bound to an objective J and its settings (a step size and sigma, both numbers or traced arrays) and is then
two pure functions, which a study compiles and runs for many members at once:

    state = init(key, u)                   u [n]: the initial guess
    state, (cost, u) = update(key, state)  one update; cost is J(u), and u the iterate, or the best of a generation

Every update is charged in simulator-evaluation equivalents: evaluations of J, a gradient counted as so many of them.
"""

import importlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Key

from tog_mjx import gradients
from tog_mjx.gradients import Estimator, Objective
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Scalar
from tog_mjx.solving.solve import update_rule

SAMPLES = 8
"""Perturbed points of the estimators that average."""
CONFIDENCE, THRESHOLD = 0.95, 10.0
"""Of `alpha_order`: the usual confidence, and gamma in 1/m, the units of the gradient. Gamma belongs into the grid of
each task, beside step and sigma, and would make it four times as large; it is one number instead. Of 0.3, 1, 3 and 10,
tried on guesses of the tuning with Adam, 10 had the most successes and the least cost on both tasks."""


class Settings(NamedTuple):
    """`step` scales the update; `sigma` is the standard deviation of perturbations, in m."""

    step: Scalar
    sigma: Scalar


class Bound(NamedTuple):
    """See the module's header."""

    init: Callable[[Key[Array, ""], Float[Array, " n"]], Any]
    update: Callable[[Key[Array, ""], Any], tuple[Any, tuple[Float[Array, ""], Float[Array, " n"]]]]


class Method(NamedTuple):
    """`bind(objective, settings, n)`, and `charge(n, gradient)` of one update, for what a gradient counts. The
    objective is to have that `differentiation`, where it is not the simulator's own."""

    bind: Callable[[Objective, Settings, int], Bound]
    charge: Callable[[int, float], float]
    differentiation: str | None = None


RULES: dict[str, Callable[[Scalar], optax.GradientTransformation]] = {
    "plain": optax.sgd,
    "adam": optax.adam,
    "clipped": lambda step: optax.chain(optax.clip_by_global_norm(1.0), optax.sgd(step)),
    "normalised": lambda step: optax.chain(optax.normalize_by_update_norm(), optax.sgd(step)),
    "solve": update_rule,
}
"""u <- u - step g; Adam; the first with |g| cut at 1 per m; with |g| = 1, so that a step is so many m long; and what
`tog.solve` takes."""


def descent(
    estimator: Callable[[Objective, Scalar], Estimator],
    rule: str,
    charge: Callable,
    differentiation: str | None = None,
) -> Method:
    """A member whose cost or gradient is not finite stays where it is."""

    def bind(objective: Objective, settings: Settings, n: int) -> Bound:
        del n
        estimate, transform = estimator(objective, settings.sigma), RULES[rule](settings.step)

        def update(key: Key[Array, ""], state: Any) -> Any:
            u, memory = state
            cost, gradient = estimate(key, u)
            change, memory = transform.update(gradient, memory, u)
            is_good = jnp.isfinite(cost) & jnp.isfinite(gradient).all()
            moved = (optax.apply_updates(u, change), memory)
            return jax.tree.map(lambda new, old: jnp.where(is_good, new, old), moved, state), (cost, u)

        return Bound(lambda key, u: (u, transform.init(u)), update)

    return Method(bind, charge, differentiation)


def evolution(name: str, population: Callable[[int], int]) -> Method:
    """An evolution strategy of evosax, its first standard deviation sigma; the step size has no part in it."""

    def bind(objective: Objective, settings: Settings, n: int) -> Bound:
        algorithm = _strategy(name)(population_size=population(n), solution=jnp.zeros(n))
        parameters = algorithm.default_params.replace(std_init=settings.sigma)

        def update(key: Key[Array, ""], state: Any) -> Any:
            ask, tell = jax.random.split(key)
            points, state = algorithm.ask(ask, state, parameters)
            costs = jax.vmap(objective)(points)
            # The ranking needs numbers: what is not finite is worse than all that is.
            ranked = jnp.where(jnp.isfinite(costs), costs, 1e9)
            state, _ = algorithm.tell(tell, points, ranked, state, parameters)
            best = ranked.argmin()
            return state, (costs[best], points[best])

        return Bound(lambda key, u: algorithm.init(key, u, parameters), update)

    return Method(bind, lambda n, gradient: population(n))


def _strategy(name: str) -> Callable:
    """A class of evosax, whose import computes with JAX: earlier than this, devices and compiler could not be set any
    more. Here it may be in the middle of a trace, of which it must not become a part."""
    with jax.ensure_compile_time_eval():
        try:
            return getattr(importlib.import_module("evosax.algorithms"), name)
        except ModuleNotFoundError:
            raise InputError(f"{name} needs the package evosax; install it with: pip install evosax") from None


def _default_population(n: int) -> int:
    """Hansen's default, even as evosax needs it."""
    return 2 * round((4 + 3 * math.log(n)) / 2)


METHODS: dict[str, Method] = {
    **{
        f"exact, {rule}": descent(lambda J, sigma: gradients.exact(J), rule, lambda n, gradient: gradient)
        for rule in ("plain", "adam", "clipped", "normalised")
    },
    **{
        f"saltation, {rule}": descent(
            lambda J, sigma: gradients.exact(J), rule, lambda n, gradient: gradient, "saltation"
        )
        for rule in RULES
    },
    "stochastic, plain": descent(gradients.stochastic, "plain", lambda n, gradient: 2),
    **{
        f"zeroth order, {rule}": descent(
            lambda J, sigma: gradients.zeroth_order(J, sigma, SAMPLES), rule, lambda n, gradient: SAMPLES + 1
        )
        for rule in ("plain", "adam")
    },
    "antithetic, adam": descent(
        lambda J, sigma: gradients.zeroth_order(J, sigma, SAMPLES // 2, antithetic=True),
        "adam",
        lambda n, gradient: SAMPLES + 1,
    ),
    "differences, adam": descent(
        lambda J, sigma: gradients.central_differences(J, 1e-6), "adam", lambda n, gradient: 2 * n + 1
    ),
    "first order, adam": descent(
        lambda J, sigma: gradients.first_order(J, sigma, SAMPLES), "adam", lambda n, gradient: SAMPLES * gradient + 1
    ),
    "mixed, adam": descent(
        lambda J, sigma: gradients.mixed(J, sigma, SAMPLES), "adam", lambda n, gradient: SAMPLES * gradient + 1
    ),
    "alpha order, adam": descent(
        lambda J, sigma: gradients.alpha_order(J, sigma, SAMPLES, CONFIDENCE, THRESHOLD),
        "adam",
        lambda n, gradient: SAMPLES * gradient + 1,
    ),
    "solve": descent(lambda J, sigma: gradients.exact(J), "solve", lambda n, gradient: gradient),
    "CMA-ES": evolution("CMA_ES", _default_population),
    "CR-FM-NES": evolution("CR_FM_NES", _default_population),
}
"""By name: "estimator, update rule", or the evolution strategy's own name. *Exact* is between two jumps of the motion,
and *saltation* with them."""


def traces(
    objective: Objective, method: str, step: float, sigma: float, guesses: Float[np.ndarray, "M n"], updates: int
) -> dict[str, np.ndarray]:
    """`costs` [M, N] and `iterates` [M, N, n], 0 to `updates`, from each guess; each has random numbers of its own."""
    bound = METHODS[method].bind(objective, Settings(jnp.asarray(step), jnp.asarray(sigma)), guesses.shape[1])

    def run(u: Float[Array, " n"], key: Key[Array, ""]) -> Any:
        first, *rest = jax.random.split(key, updates + 2)
        return jax.lax.scan(lambda state, key: bound.update(key, state), bound.init(first, u), jnp.stack(rest))[1]

    costs, iterates = jax.jit(jax.vmap(run))(guesses, jax.random.split(jax.random.key(0), len(guesses)))
    return {"costs": np.asarray(costs), "iterates": np.asarray(iterates)}
