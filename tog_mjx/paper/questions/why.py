"""Why one gradient wins: the state of J and of the estimates at iterates of descents, against what a step then gains.

At each iterate u, for each sigma, 64 samples w ~ N(0, sigma^2 I) give the statistics; the gradient of the smoothed
J_sigma(u) = E J(u + w) is the antithetic zeroth-order mean over many more, which is unbiased also where J jumps. Then a
step of 1 cm is tried against each direction, and one of 1 mm. Zeroth order at equal cost has as many evaluations as one
gradient counts for, J(u) included; it is drawn 64 times, and `exact wins` is the share of draws that gain less than the
exact gradient. That is the gradient between two jumps of the motion; the one with the jumps is tried at the same
iterates, and `saltation wins` likewise.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure

from tog_mjx.engines import SIMULATORS, precision
from tog_mjx.engines.objective import objective
from tog_mjx.gradients import Objective, exact_batch, local
from tog_mjx.paper.questions.predictions import draw_why
from tog_mjx.paper.tasks import TASKS, Rule, get_task
from tog_mjx.running.batches import map_points
from tog_mjx.running.digests import made_with
from tog_mjx.solving.methods import traces
from tog_mjx.solving.solve import step_size
from tog_mjx.studies.predictors import STATISTICS, choose, judge, most_predictive, rank_correlations, values_of
from tog_mjx.studies.study import Store

NEAR = 0.01
"""The smaller sigma, that of the local statistics, and the length of the step, in m."""
SHORT = NEAR / 10
"""Another length, in m."""
NOISE = 0.03
"""Standard deviation of the guesses about the paper's, which is the first of them, in m."""
DRAWS, AVERAGED = 64, 8
LEVEL = 1e-4
"""Changes of J below it count as none."""


def measure(
    J: Objective,
    with_jumps: Objective,
    iterates: Float[np.ndarray, "K n"],
    sigmas: tuple[float, ...],
    equal: int,
    pairs: int,
    report: Callable,
) -> list[dict[str, Any]]:
    """One row an iterate and sigma; the first sigma is that of the local statistics. `with_jumps` is J with the other
    gradient. `equal` samples are as dear as an exact gradient, and `pairs` (at least 64 * equal) give the smoothed
    gradient."""
    (K, n), S = iterates.shape, len(sigmas)
    normals = np.random.default_rng(0).normal(size=(K, S, pairs, n))
    shifts = np.array(sigmas)[:, None, None] * normals
    centre, chunk = iterates[:, None, None], SIMULATORS["penalty"].CHUNK
    steep = np.concatenate([centre, (centre + shifts[:, :, :DRAWS]).reshape(K, 1, -1, n)], axis=2)
    costs, slopes = map_points(exact_batch(J), steep.reshape(-1, n), chunk=chunk)
    costs, slopes = costs.reshape(K, -1), slopes.reshape(K, -1, n)
    jumping = map_points(exact_batch(with_jumps), iterates, chunk=chunk)[1]
    both = np.stack([centre + shifts, centre - shifts], axis=2)
    around = map_points(jax.vmap(J), both.reshape(-1, n), report, chunk).reshape(K, S, 2, -1)
    ahead, behind = around[:, :, 0], around[:, :, 1]
    found, targets = [], []
    for k, s in np.ndindex(K, S):
        w, sigma, nearest = normals[k, s], sigmas[s], slice(1, 1 + DRAWS)
        terms = local.zeroth_terms(ahead[k, s] - costs[k, 0], w, sigma)
        symmetric = local.zeroth_terms((ahead[k, s] - behind[k, s]) / 2, w, sigma)
        firsts = slopes[k, 1 + s * DRAWS : 1 + (s + 1) * DRAWS]
        found.append(
            {
                "sigma": sigma,
                "J": costs[k, 0],
                **_errors(slopes[k, 0], jumping[k], firsts, terms[:DRAWS], symmetric),
                "flatness": local.flatness(costs[k, nearest], costs[k, 0], LEVEL),
                "roughness": local.roughness(costs[k, nearest], normals[k, 0, :DRAWS]),
                "steepness": local.steepness(slopes[k, nearest]),
            }
        )
        first = firsts.mean(0)
        rivals = terms[: DRAWS * equal].reshape(DRAWS, equal, n).mean(1)
        ways = np.concatenate([[slopes[k, 0], first, terms[:AVERAGED].mean(0), jumping[k]], rivals])
        targets.append([local.stepped(iterates[k], ways, length) for length in (NEAR, SHORT)])
    reached = map_points(jax.vmap(J), np.concatenate(targets).reshape(-1, n), chunk=chunk).reshape(K * S, 2, -1)
    return [
        {
            **row,
            **_gains(row["J"] - far),
            **{f"{name}, 1 mm": value for name, value in _gains(row["J"] - close).items()},
        }
        for row, (far, close) in zip(found, reached, strict=True)
    ]


def _errors(
    exact: Float[np.ndarray, " n"],
    saltation: Float[np.ndarray, " n"],
    firsts: Float[np.ndarray, "N n"],
    zeroths: Float[np.ndarray, "N n"],
    symmetric: Float[np.ndarray, "M n"],
) -> dict[str, float]:
    """Of both gradients and of the samples of each order, against the smoothed gradient, the mean of `symmetric`."""
    smooth = symmetric.mean(0)
    return {
        "gradient": float(np.linalg.norm(exact)),
        "snr0": local.signal_to_noise(zeroths),
        "snr1": local.signal_to_noise(firsts),
        "cosine": local.cosine(exact, smooth),
        "cosine, saltation": local.cosine(saltation, smooth),
        "bias": local.relative_error(exact, smooth),
        "bias1": local.relative_error(firsts.mean(0), smooth),
        "smooth noise": local.noise_of_mean(symmetric),
    }


def _measured(name: str, points: np.ndarray, sigmas: tuple[float, ...], pairs: int, report: Callable) -> pd.DataFrame:
    equal = int(SIMULATORS["penalty"].GRADIENT_CHARGE) - 1
    with precision("penalty"):
        both = objective(name, "penalty"), objective(name, "penalty", differentiation="saltation")
        return pd.DataFrame(measure(*both, points, sigmas, equal, pairs, report))


def _gains(gains: Float[np.ndarray, " N"]) -> dict[str, Any]:
    """What each direction's step gained: exact, smoothed, zeroth order of 8, saltation, and those at equal cost."""
    three = dict(zip(("exact", "smoothed", "zeroth"), gains[:3], strict=True))
    best = max(three, key=lambda name: three[name])
    return {
        **{f"gain, {name}": gain for name, gain in three.items()},
        "gain, saltation": gains[3],
        "gain, equal": gains[4:].mean(),
        "wins": best if three[best] > 0 else "none",
        "exact wins": local.beaten(gains[0], gains[4:]),
        "saltation wins": local.beaten(gains[3], gains[4:]),
    }


def descents(name: str, guesses: int) -> dict[str, np.ndarray]:
    """The iterates [guesses, N, n] of Table I's two rules and of `solve`."""
    task, updates = get_task(name), int(get_task(name).budget / SIMULATORS["penalty"].GRADIENT_CHARGE)
    off = NOISE * np.random.default_rng(0).normal(size=(guesses, task.initial_guess.size))
    off[0] = 0
    rules = {
        "exact": ("exact, plain", task.exact),
        "stochastic": ("stochastic, plain", task.stochastic),
        "solve": ("solve", Rule(step_size(task, updates), updates - 1)),
    }
    with precision("penalty"):
        run = functools.partial(traces, objective(task, "penalty"), guesses=task.initial_guess + off)
        return {
            of: run(method, rule.step_size, rule.sigma, updates=rule.iterations)["iterates"]
            for of, (method, rule) in rules.items()
        }


@dataclasses.dataclass(frozen=True)
class Why:
    """Implements `Study`. A row each task, descent, guess, iterate and sigma."""

    question: str = "What tells beforehand whether the exact gradient gains more than a stochastic one?"

    def run(self, quick: bool, store: Store, piece: Callable) -> pd.DataFrame:
        tables = []
        guesses, number, pairs = (2, 3, 256) if quick else (10, 5, 2048)
        for name in TASKS:
            sigmas, program = (NEAR, get_task(name).stochastic.sigma), made_with(get_task(name).scene.model, __name__)
            with piece(f"{name} penalty, descents", 1) as report:
                make_descents = functools.partial(descents, name, guesses)
                shape = (guesses, None, get_task(name).initial_guess.size)
                shapes = dict.fromkeys(("exact", "stochastic", "solve"), shape)
                made = store.finish_part(f"why_{name}_descents", {"guesses": guesses, **program}, make_descents, shapes)
                kept = {of: _spread(some.shape[1], number) for of, some in made.items()}
                report(1)
            points = np.concatenate([made[of][:, some].reshape(-1, made[of].shape[2]) for of, some in kept.items()])
            settings = {"points": points.tolist(), "pairs": pairs, **program}
            with piece(f"{name} penalty", len(points) * len(sigmas) * 2 * pairs) as report:
                make = functools.partial(_measured, name, points, sigmas, pairs, report)
                rows = store.finish_table(f"why_{name}", settings, make)
            labels = [
                (name, of, g, i) for of, some in kept.items() for g in range(guesses) for i in some for _ in sigmas
            ]
            tables.append(pd.DataFrame(labels, columns=["task", "descent", "guess", "iteration"]).join(rows))
        return pd.concat(tables, ignore_index=True)

    def summary(self, table: pd.DataFrame) -> pd.DataFrame:
        """Of all iterates and of each descent: rates, each statistic's rank correlation, and what `judge` says."""
        groups = [(name, "all", rows) for name, rows in [("both", table), *table.groupby("task", sort=False)]]
        groups += [(*of, rows) for of, rows in table.groupby(["task", "descent"], sort=False)]
        choices = choose(table)
        found = [
            {"task": name, "descent": of, "sigma": sigma, **_answer(some), **judge(choices, some)}
            for name, of, rows in groups
            for sigma, some in [(s, x) for s, x in rows.groupby("sigma") if name != "both" or s == NEAR]
        ]
        return pd.DataFrame(found)

    def draw(self, quick: bool, store: Store, table: pd.DataFrame) -> Figure:
        del quick, store
        return draw_why(table, most_predictive(choose(table)))


def _spread(length: int, number: int) -> np.ndarray:
    """Up to so many of the indices below `length`, evenly spaced, both ends included."""
    return np.unique(np.linspace(0, length - 1, number).round().astype(int))


def _answer(some: pd.DataFrame) -> dict[str, Any]:
    three = ("exact", "smoothed", "zeroth")
    lowers = {f"{name} lowers": (some[f"gain, {name}"] > 0).mean() for name in three}
    wins = {f"{name} best": (some.wins == name).mean() for name in three}
    ranks = {f"rho {name}": rho for name, rho in zip(STATISTICS, rank_correlations(values_of(some)), strict=True)}
    short = {
        "exact wins, 1 mm": some["exact wins, 1 mm"].mean(),
        "exact lowers, 1 mm": (some["gain, exact, 1 mm"] > 0).mean(),
    }
    jumps = {
        "saltation lowers": (some["gain, saltation"] > 0).mean(),
        "saltation wins": some["saltation wins"].mean(),
        "saltation beats exact": (np.sign(some["gain, saltation"] - some["gain, exact"]).mean() + 1) / 2,
        "rho cosine, saltation": rank_correlations(some[["cosine, saltation", "saltation wins"]].to_numpy(float))[0],
    }
    return {"iterates": len(some), "exact wins": some["exact wins"].mean(), **lowers, **wins, **short, **ranks, **jumps}
