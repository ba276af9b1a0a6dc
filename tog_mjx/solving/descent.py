"""Gradient descent with any estimator and update rule, and the record of a run.

The plain update is u <- u - alpha g: with the exact estimator the paper's equation 8, with the stochastic one its
equation 9.
The whole loop is one compiled function. It is called a few times a second, not once an iteration, so that a run can
report how far it is.
"""

import enum
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, Key

from tog_mjx.gradients import Estimator
from tog_mjx.running.errors import InputError, require_whole
from tog_mjx.running.older_names import OlderAttribute
from tog_mjx.running.types import Numbers

REPORT_INTERVAL = 0.5
"""Seconds between reports, about."""


class Status(enum.Enum):
    """How a descent ended; the value is the message."""

    CONVERGED = "converged"
    EXHAUSTED = "iterations exhausted"
    NON_FINITE = "non-finite gradient"


class Descent(NamedTuple):
    """The record of a run: costs [k + 1], setpoints [k + 1, n] and gradient estimates [k + 1, n] of iterates 0 to k.

    Where what is varied is a pytree, these two are such pytrees, with the axis [k + 1] before those of each leaf.
    Every recorded cost is finite: the last iterate is the last good one. Seconds are wall time, compilation apart.
    `held_out` [k + 1] is of a problem with many starts, each of whose costs is that of its own draw: mean costs on
    starts that no update has seen, the same for all iterates that were judged, infinite where a motion is; else NaN.

    Units: of costs and of variables those of J; seconds.
    """

    costs: np.ndarray
    setpoints: Any
    gradients: Any
    status: Status
    seconds_compile: float
    seconds_run: float
    held_out: np.ndarray | None = None

    def __repr__(self) -> str:
        """In one line: what it has found, and how it ended."""
        judged = "" if self.held_out is None else f", on held-out starts {np.nanmin(self.held_out):.4g}"
        found = f"J from {self.costs[0]:.4g} to {self.costs[self.best_iteration]:.4g}{judged}"
        return f"Descent: {found}, at iterate {self.best_iteration} of {self.iterations} ({self.ended}); `best` has it"

    @property
    def ended(self) -> str:
        """How it ended, and where no gradient led anywhere the remedy."""
        flat = not any(np.any(leaf) for leaf in jax.tree.leaves(self.gradients))
        return self.status.value + "; every gradient was zero: begin elsewhere" * flat

    @property
    def iterations(self) -> int:
        """The number of updates made."""
        return len(self.costs) - 1

    @property
    def best_iteration(self) -> int:
        """The first iterate of least cost, on the held-out starts if there are any."""
        return int(self.costs.argmin() if self.held_out is None else np.nanargmin(self.held_out))

    @property
    def last(self) -> Any:
        """The last iterate [n], of cost `costs[-1]`."""
        return jax.tree.map(lambda all_: all_[-1], self.setpoints)

    @property
    def best(self) -> Any:
        """The best iterate [n], of cost `costs[best_iteration]`."""
        return jax.tree.map(lambda all_: all_[self.best_iteration], self.setpoints)

    @OlderAttribute.of("last")
    def setpoints_last(self) -> Any:
        return self.last

    @OlderAttribute.of("best")
    def setpoints_best(self) -> Any:
        return self.best


class _Loop(NamedTuple):
    """The carry of the loop; `iteration` is that of the next evaluation, the records are filled up to it."""

    iteration: Int[Array, ""]
    key: Key[Array, ""]
    u: Float[Array, " n"]
    memory: Any
    costs: Float[Array, " N"]
    setpoints: Float[Array, "N n"]
    gradients: Float[Array, "N n"]
    converged: Bool[Array, ""]
    failed: Bool[Array, ""]


def descend(
    estimate: Estimator,
    u: Numbers,
    *,
    iterations: int,
    step_size: float | None = None,
    rule: optax.GradientTransformation | None = None,
    key: Key[Array, ""] | None = None,
    tolerance: float | None = None,
    report: Callable[[int], None] | None = None,
) -> Descent:
    """Descends from u for `iterations` updates.

    Args:
      estimate: `(key, u) -> (cost, gradient)`, see `tog_mjx.gradients`.
      u: initial guess [n].
      step_size: alpha of the plain update, positive.
      rule: another update rule, of optax; give this or `step_size`.
      key: random key, split once an iteration; the default is `jax.random.key(0)`.
      tolerance: end as converged once an update is not longer than this (in the units of u). Only for estimators
        without noise; the default is never.
      report: called now and then with the number of iterates evaluated so far, out of iterations + 1.

    Returns:
      the record. The run ends early, with status NON_FINITE, at the first iterate with a NaN or infinite cost (which is
      not recorded) or gradient (the iterate is recorded and not left).

    Raises:
      InputError: for settings out of range, a guess that is not a vector, or a first cost that is not finite.

    Units: those of J and of u.
    Gradient: none of a descent, whose record is NumPy's.
    Source: the paper's equations 8 and 9, and update rules of optax.
    """
    iterations = require_whole("iterations", iterations, 0)
    if (step_size is None) == (rule is None):
        raise InputError("give either a step_size, for plain descent, or an update rule of optax")
    if step_size is not None and not 0 < step_size < float("inf"):
        raise InputError(f"step_size is {step_size}: give a positive number")
    rule = optax.sgd(step_size) if rule is None else rule
    if tolerance is not None and not tolerance >= 0:
        raise InputError(f"tolerance is {tolerance}: give 0 or more, or None")
    try:
        u = jnp.asarray(u, float)
    except (TypeError, ValueError):
        raise InputError(f"the initial guess {u!r} is not numbers; give a vector of them") from None
    if u.ndim != 1 or u.size == 0:
        raise InputError(f"the initial guess has shape {u.shape}; give a vector [n]")
    records = iterations + 1
    loop = _Loop(
        iteration=jnp.array(0),
        key=jax.random.key(0) if key is None else key,
        u=u,
        memory=rule.init(u),
        costs=jnp.zeros(records, u.dtype),
        setpoints=jnp.zeros((records, u.size), u.dtype),
        gradients=jnp.zeros((records, u.size), u.dtype),
        converged=jnp.array(False),
        failed=jnp.array(False),
    )
    started = time.perf_counter()
    advance = _compile_advance(estimate, rule, tolerance, loop)
    seconds_compile = time.perf_counter() - started

    started, chunk = time.perf_counter(), 1
    while (done := int(loop.iteration)) < records and not (bool(loop.converged) or bool(loop.failed)):
        before = time.perf_counter()
        loop = jax.block_until_ready(advance(loop, jnp.array(min(done + chunk, records))))
        if report is not None:
            report(int(loop.iteration))
        pace = (time.perf_counter() - before) / chunk
        chunk = max(1, int(REPORT_INTERVAL / max(pace, 1e-9)))
    return _record(loop, seconds_compile, time.perf_counter() - started)


def _compile_advance(
    estimate: Estimator, rule: optax.GradientTransformation, tolerance: float | None, loop: _Loop
) -> Callable[[_Loop, Array], _Loop]:
    """The compiled function that evaluates and updates until iterate number `stop`, or until the run ends."""

    def unfinished(loop: _Loop, stop: Int[Array, ""]) -> Bool[Array, ""]:
        return (loop.iteration < stop) & ~loop.converged & ~loop.failed

    def iterate(loop: _Loop) -> _Loop:
        key, subkey = jax.random.split(loop.key)
        cost, gradient = estimate(subkey, loop.u)
        step, memory = rule.update(gradient, loop.memory, loop.u)
        failed = ~(jnp.isfinite(cost) & jnp.isfinite(gradient).all())
        converged = jnp.array(False) if tolerance is None else ~failed & (jnp.linalg.norm(step) <= tolerance)
        i = loop.iteration
        return _Loop(
            iteration=i + 1,
            key=key,
            u=jnp.where(failed | converged, loop.u, optax.apply_updates(loop.u, step)),
            memory=memory,
            costs=loop.costs.at[i].set(cost),
            setpoints=loop.setpoints.at[i].set(loop.u),
            gradients=loop.gradients.at[i].set(gradient),
            converged=converged,
            failed=failed,
        )

    def advance(loop: _Loop, stop: Int[Array, ""]) -> _Loop:
        return jax.lax.while_loop(lambda loop: unfinished(loop, stop), iterate, loop)

    return jax.jit(advance).lower(loop, jnp.array(0)).compile()


def _record(loop: _Loop, seconds_compile: float, seconds_run: float) -> Descent:
    """Cuts the records to the good iterates and names the end."""
    evaluated = int(loop.iteration)
    costs = np.asarray(loop.costs)[:evaluated]
    good = evaluated if np.isfinite(costs[-1]) else evaluated - 1
    if good == 0:
        raise InputError(f"the cost of the initial guess is {costs[0]}; start from setpoints whose motion stays finite")
    failed, converged = bool(loop.failed), bool(loop.converged)
    return Descent(
        costs[:good],
        np.asarray(loop.setpoints)[:good],
        np.asarray(loop.gradients)[:good],
        Status.NON_FINITE if failed else Status.CONVERGED if converged else Status.EXHAUSTED,
        seconds_compile,
        seconds_run,
    )
