"""Which statistic of an iterate predicts that the exact gradient wins, judged on descents that did not choose it.

Iterates of a descent resemble each other, and so do descents from one guess: all of a guess are held out together. Of
each resample of the guesses, with replacement, the statistic that best predicts there is judged on the guesses that the
resample lacks. Tables are those of the study `why`.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import rankdata

STATISTICS = ("gradient", "snr0", "snr1", "cosine", "bias", "bias1", "flatness", "roughness", "steepness")
"""Norm of the exact gradient; signal-to-noise ratios of one term of zeroth and first order; cosine of the exact and the
smoothed gradient; error of the exact gradient and of the mean of first order, relative to the smoothed one; and J
within 1 cm, see `local`."""
RESAMPLES = 500
"""Of the guesses."""


class Choice(NamedTuple):
    """Of one resample: the guesses it lacks; a statistic; and whether more of it (1) or less (-1) predicts a win."""

    outside: np.ndarray
    statistic: str
    sign: float


def choose(table: pd.DataFrame) -> list[Choice]:
    """Of each resample the statistic whose rank correlation, averaged over tasks and sigmas, is largest."""
    rng, number = np.random.default_rng(0), table.guess.max() + 1
    found: list[Choice] = []
    groups = [(some.guess.to_numpy(), values_of(some)) for _, some in table.groupby(["task", "sigma"])]
    while len(found) < RESAMPLES:
        times = np.bincount(rng.integers(number, size=number), minlength=number)
        if times.all():
            continue  # It lacks none.
        mean = np.mean([rank_correlations(np.repeat(values, times[guess], axis=0)) for guess, values in groups], axis=0)
        best = int(np.abs(mean).argmax())
        found.append(Choice(np.flatnonzero(times == 0), STATISTICS[best], float(np.sign(mean[best]))))
    return found


def most_predictive(choices: Sequence[Choice]) -> str:
    """The statistic that is chosen most often."""
    return Counter(choice.statistic for choice in choices).most_common(1)[0][0]


def judge(choices: Sequence[Choice], some: pd.DataFrame) -> dict[str, Any]:
    """The rank correlation, `held out`, of what was chosen without the guesses on which it is judged: the mean of all
    resamples, with 95 % of them between `low` and `high`. `chosen` is the share that chose the `predictor`."""
    guess, values = some.guess.to_numpy(), values_of(some)
    held_out = [
        choice.sign * rank_correlations(values[np.isin(guess, choice.outside)])[STATISTICS.index(choice.statistic)]
        for choice in choices
    ]
    predictor = most_predictive(choices)
    low, high = np.quantile(held_out, [0.025, 0.975])
    share = np.mean([choice.statistic == predictor for choice in choices])
    return {"predictor": predictor, "chosen": share, "held out": np.mean(held_out), "low": low, "high": high}


def values_of(some: pd.DataFrame) -> Float[np.ndarray, "N k"]:
    """The statistics, and in the last column what they are to predict."""
    return some[[*STATISTICS, "exact wins"]].to_numpy(float)


def rank_correlations(values: Float[np.ndarray, "N k"]) -> np.ndarray:
    """Spearman's, of each column but the last with the last; 0 where one of the two does not vary."""
    ranks = rankdata(values, axis=0)
    ranks -= ranks.mean(axis=0)
    sizes = np.linalg.norm(ranks, axis=0)
    scale = sizes[:-1] * sizes[-1]
    return np.where(scale > 0, ranks[:, :-1].T @ ranks[:, -1] / np.where(scale > 0, scale, 1), 0.0)
