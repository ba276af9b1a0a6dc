"""A cell of a study: one method on one task and simulator, run for all members at once, and kept as one file.

Members are all combinations of seed, noise of the initial guess, step size and sigma; equal seeds have equal guesses
and random numbers, whatever the method.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.engines import SIMULATORS, gradient_charge, objective, precision
from tog_mjx.gradients import Objective
from tog_mjx.problems import Problem
from tog_mjx.problems.library import get_problem
from tog_mjx.running.batches import map_points
from tog_mjx.running.devices import over_devices
from tog_mjx.running.digests import made_with
from tog_mjx.running.types import Scalar
from tog_mjx.solving.methods import METHODS, Settings

PIECE = 20
"""Updates between two reports, at most."""


class Member(NamedTuple):
    """One run: `noise` is the standard deviation of its initial guess about the paper's, in m."""

    seed: int
    noise: float
    step: float
    sigma: float


@dataclasses.dataclass(frozen=True)
class Cell:
    """`updates` of `method` for each member. `symmetric` restricts the grasp's setpoints to mirror images, and
    `error` > 0 descends on J averaged over setpoint errors of that standard deviation (m), 8 fixed draws.
    `tested` lists the errors under which the best setpoints are tried afterwards, 256 draws each. `options` are the
    simulator's, as pairs of name and value. With `window` > 0 the guess of seed i is, but for noise, point i of the
    task's landscape of window x window points."""

    task: str
    simulator: str
    method: str
    updates: int
    seeds: tuple[int, ...] = (0,)
    noises: tuple[float, ...] = (0.0,)
    steps: tuple[float, ...] = (0.0,)
    sigmas: tuple[float, ...] = (0.0,)
    knots: int = 1
    symmetric: bool = False
    error: float = 0.0
    tested: tuple[float, ...] = ()
    options: tuple[tuple[str, str], ...] = ()
    window: int = 0

    @property
    def members(self) -> list[Member]:
        return [Member(*choice) for choice in itertools.product(self.seeds, self.noises, self.steps, self.sigmas)]

    @property
    def charge(self) -> float:
        """Evaluation equivalents of one update."""
        draws = _DRAWS if self.error else 1
        variables = len(_variables(self, get_problem(self.task, knots=self.knots).x0))
        method = METHODS[self.method]
        return float(draws * method.charge(variables, gradient_charge(self.simulator, method.differentiation)))

    @property
    def shapes(self) -> dict[str, tuple[int | None, ...]]:
        """Of what is found, by name."""
        members = len(self.members)
        points = (members, get_problem(self.task, knots=self.knots).x0.size)
        iterates = dict.fromkeys(("first", "best", "last"), points)
        return {"costs": (members, self.updates), **iterates, "tried": (members, len(self.tested), _TRIES)}

    def settings(self) -> dict[str, Any]:
        """All that the result depends on."""
        return {**dataclasses.asdict(self), **made_with(get_problem(self.task).scene.model, __name__)}


def updates_within(budget: int | float, cell: Cell) -> Cell:
    """The same cell with as many updates as the budget of evaluation equivalents pays for."""
    return dataclasses.replace(cell, updates=max(1, int(budget / cell.charge)))


class Found(NamedTuple):
    """Costs [members, updates]; the first, best and last iterate [members, n] as setpoints; and the costs of the best
    under setpoint errors [members, tested, 256]."""

    costs: np.ndarray
    first: np.ndarray
    best: np.ndarray
    last: np.ndarray
    tried: np.ndarray


_DRAWS, _TRIES = 8, 256


def compute(cell: Cell, report: Callable[[int], None] = lambda _: None) -> Found:
    """Runs all members. `report` is called with the number of updates made."""
    with precision(cell.simulator, **dict(cell.options)):
        task = get_problem(cell.task, knots=cell.knots)
        objective, expand = _objective(cell, task)
        pieces = []
        for piece in _pieces(cell, objective, _guesses(cell, task)):
            pieces.append(piece)
            report(min(len(pieces) * piece[0].shape[1], cell.updates))
        costs, iterates = (np.concatenate(some, axis=1)[:, : cell.updates] for some in zip(*pieces, strict=True))
        best = np.where(np.isfinite(costs), costs, np.inf).argmin(axis=1)
        chosen = (iterates[:, 0], iterates[np.arange(len(best)), best], iterates[:, -1])
        setpoints = [np.asarray(jax.vmap(expand)(jnp.asarray(some))) for some in chosen]
        return Found(costs, setpoints[0], setpoints[1], setpoints[2], _try(cell, task, setpoints[1]))


def _try(cell: Cell, task: Problem, setpoints: np.ndarray) -> np.ndarray:
    """J [members, tested, 256] under setpoint errors that are the same for all."""
    cost = objective(task, cell.simulator, **dict(cell.options))
    normal = np.random.default_rng(1).normal(size=(_TRIES, setpoints.shape[1]))
    errors = np.array(cell.tested)[:, None, None] * normal
    points = setpoints[:, None, None] + errors
    flat = points.reshape(-1, setpoints.shape[1])
    costs = map_points(jax.vmap(cost), flat, chunk=SIMULATORS[cell.simulator].CHUNK) if len(flat) else np.zeros(0)
    return costs.reshape(points.shape[:-1])


def _pieces(cell: Cell, objective: Objective, guesses: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Costs [members, length] and iterates [members, length, n], in the fewest pieces of equal length."""
    method, n = METHODS[cell.method], guesses.shape[1]
    length = -(-cell.updates // -(-cell.updates // PIECE))

    def key_of(seed: Array, purpose: int) -> Array:
        return jax.random.fold_in(jax.random.key(seed), purpose)

    def begin(member: Any) -> Any:
        guess, seed, noise, settings = member
        u = guess + noise * jax.random.normal(key_of(seed, 0), (n,), noise.dtype)
        return method.bind(objective, settings, n).init(key_of(seed, 1), u)

    def advance(member: Any, state: Any, first: Array) -> Any:
        _, seed, _, settings = member
        update = method.bind(objective, settings, n).update
        stream = key_of(seed, 2)
        return jax.lax.scan(
            lambda state, i: update(jax.random.fold_in(stream, i), state), state, first + jnp.arange(length)
        )

    members, count = cell.members, len(cell.members)
    padded = np.resize(np.arange(count), -(-count // jax.device_count()) * jax.device_count())
    seeds, noises, steps, sigmas = (np.array(axis)[padded] for axis in zip(*members, strict=True))
    batch = (guesses[padded], seeds, noises.astype(float), Settings(steps.astype(float), sigmas.astype(float)))
    state = over_devices(jax.vmap(begin))(batch)
    run = over_devices(lambda given: jax.vmap(advance)(*given))
    for first in range(0, cell.updates, length):
        state, found = run((batch, state, np.full(len(padded), first)))
        yield tuple(some[:count] for some in found)


def _variables(cell: Cell, setpoints: np.ndarray) -> np.ndarray:
    """The decision variables [n] of setpoints."""
    return setpoints.reshape(cell.knots, -1, 2)[:, 0].ravel() if cell.symmetric else setpoints


def _guesses(cell: Cell, task: Problem) -> np.ndarray:
    """The decision variables [members, n] to which noise is added: those of the paper's guess, or of the window."""
    if not cell.window:
        return np.tile(_variables(cell, task.x0), (len(cell.members), 1))
    points = task.plane.grid(cell.window)[[member.seed for member in cell.members]]
    return np.stack([_variables(cell, setpoints) for setpoints in np.asarray(task.plane.x(points))])


def _objective(cell: Cell, task: Problem) -> tuple[Objective, Callable[[Float[Array, " n"]], Array]]:
    """J of the decision variables, and the setpoints that they stand for."""
    options, differentiation = dict(cell.options), METHODS[cell.method].differentiation
    if differentiation:
        options["differentiation"] = differentiation
    J = objective(task, cell.simulator, **options)

    def expand(v: Float[Array, " n"]) -> Float[Array, " m"]:
        if not cell.symmetric:
            return v
        left = v.reshape(task.knots, 1, 2)
        return jnp.concatenate([left, left * jnp.array([-1, 1])], axis=1).ravel()

    def cost(v: Float[Array, " n"]) -> Scalar:
        u = expand(v)
        if not cell.error:
            return J(u)
        errors = cell.error * jax.random.normal(jax.random.key(0), (_DRAWS, u.size), u.dtype)
        return jax.vmap(lambda error: J(u + error))(errors).mean()

    return cost, expand
