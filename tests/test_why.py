"""Statistics of J about a point against closed forms, and what they say of a quadratic and of the tasks."""

import contextlib
import itertools

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.stats import spearmanr

from tog_mjx.gradients import local
from tog_mjx.paper.comparison import Run, compute
from tog_mjx.paper.questions.why import Why, measure
from tog_mjx.studies.predictors import RESAMPLES, STATISTICS, choose, most_predictive, rank_correlations
from tog_mjx.studies.study import Drawn, Store

SLOPE = np.array([3.0, -4.0, 1.0])


def samples(number: int, n: int = 3) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(number, n))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize("sigma", [0.01, 0.5])
def test_zeroth_order_of_a_linear_function(scale, sigma):
    """mean g and trace (n + 1) |g|^2: a ratio of 1 / sqrt(n + 1), here of 1/2, within the noise of 1e5 samples."""
    normals = samples(100_000)
    terms = local.zeroth_terms(sigma * normals @ (scale * SLOPE), normals, sigma)
    assert local.signal_to_noise(terms) == pytest.approx(0.5, abs=0.01)


def test_signal_to_noise_at_its_edges():
    assert local.signal_to_noise(np.tile(SLOPE, (5, 1))) == np.inf
    assert local.signal_to_noise(np.zeros((5, 3))) == 0
    assert local.signal_to_noise(samples(100_000)) < 0.01  # Nothing but noise.
    assert local.signal_to_noise(samples(100_000) + SLOPE) == pytest.approx((26 / 3) ** 0.5, rel=0.01)


def test_noise_of_a_mean():
    assert local.noise_of_mean(samples(10_000) + SLOPE) == pytest.approx((3 / 26) ** 0.5 / 100, rel=0.03)
    assert local.noise_of_mean(np.tile(SLOPE, (5, 1))) == 0
    assert local.noise_of_mean(np.zeros((5, 3))) == 0


def test_cosine_and_relative_error():
    assert local.cosine(SLOPE, -2 * SLOPE) == pytest.approx(-1)
    assert local.cosine(SLOPE, 0 * SLOPE) == 0
    assert local.relative_error(1.5 * SLOPE, SLOPE) == pytest.approx(0.5)
    assert local.relative_error(SLOPE, 0 * SLOPE) == np.inf
    assert local.relative_error(0 * SLOPE, 0 * SLOPE) == 0


def test_flat_rough_and_steep():
    normals = samples(64)
    linear = 2 + normals @ SLOPE
    assert local.roughness(linear, normals) == pytest.approx(0, abs=1e-12)
    assert local.roughness(np.ones(64), normals) == 0
    many = samples(100_000)
    assert local.roughness(many[:, 0] ** 2, many) == pytest.approx(1, abs=0.01)  # An even function has no slope.
    assert local.flatness(np.array([1.0, 1.1, 0.95, 2.0]), 1.0, 0.2) == 0.75
    assert local.steepness(np.outer([1.0, 2.0, 10.0], SLOPE)) == pytest.approx(5)
    assert local.steepness(np.outer([0.0, 0.0, 1.0], SLOPE)) == np.inf
    assert local.steepness(np.zeros((3, 3))) == 1


def test_a_step_has_its_length_or_none():
    ways = np.array([SLOPE, 0 * SLOPE, np.nan * SLOPE])
    found = local.stepped(np.ones(3), ways, 0.01)
    np.testing.assert_allclose(found - 1, [-0.01 * SLOPE / 26**0.5, np.zeros(3), np.zeros(3)], rtol=1e-12)


def test_a_tie_counts_half():
    assert local.beaten(1.0, np.array([0.0, 1.0, 2.0, 0.5])) == 0.625


def test_a_quadratic_is_measured():
    """Smooth: all orders agree, and the exact gradient beats zeroth order, whose directions are off."""
    points, downhill = np.array([[1.0, 2.0], [-3.0, 1.0]]), lambda u: jnp.sum(u**2)
    rows = measure(downhill, lambda u: -jnp.sum(u), points, (0.01, 0.1), 3, 4096, lambda _: None)
    assert [row["sigma"] for row in rows] == [0.01, 0.1, 0.01, 0.1]
    for row, size, total in zip(rows, (5, 5, 10, 10), (3, 3, -2, -2), strict=True):
        length = size**0.5
        assert row["J"] == pytest.approx(size)
        assert row["gradient"] == pytest.approx(2 * length)
        assert row["snr0"] == pytest.approx(3**-0.5, abs=0.3)  # Of 64 samples.
        assert row["cosine"] == pytest.approx(1, abs=0.01)
        assert row["cosine, saltation"] == pytest.approx(-total / (2**0.5 * length), abs=0.05)
        assert row["bias"] < 5 * row["smooth noise"] < 0.2
        assert row["gain, exact"] == pytest.approx(2 * 0.01 * length - 1e-4)
        assert row["gain, exact, 1 mm"] == pytest.approx(2 * 0.001 * length - 1e-6)
        assert row["gain, saltation"] == pytest.approx(-(2**0.5) * 0.01 * total - 1e-4)
        assert row["exact wins"] > 0.95
        assert row["saltation wins"] < row["exact wins"]
        assert row["flatness"] < 0.1
        assert row["roughness"] < 0.02


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("why"), False)
    return Why().run(True, store, lambda *_: contextlib.nullcontext(lambda _: None))


def test_the_exact_gradient_wins_more_often_than_not(table):
    found = Why().summary(table).set_index(["task", "descent", "sigma"])
    assert found.loc[("both", "all", 0.01), "iterates"] == 2 * 3 * 2 * 3  # Tasks, descents, guesses and iterates.
    assert found.loc[("both", "all", 0.01), "exact wins"] > 0.6
    # On a descent that follows it by short steps it is no longer the one that gains.
    assert found.loc[("grasp", "solve", 0.01), "exact wins"] < found.loc[("grasp", "exact", 0.01), "exact wins"]


def test_the_figure_shows_every_row(table, tmp_path):
    study = Why()
    assert isinstance(study, Drawn)
    figure = study.draw(True, Store(tmp_path, False), table)
    drawn = sum(np.shape(points.get_offsets())[0] for axes in figure.axes for points in axes.collections)
    assert drawn == len(table)
    # From the paper's guess, the first one, the exact rule is Table I's.
    chosen = (table.task == "flip") & (table.descent == "exact") & (table.guess == 0) & (table.sigma == 0.01)
    costs = compute(Run("penalty", "flip", "exact")).costs
    assert table[chosen].iteration.tolist() == [0, 2, 5]
    np.testing.assert_allclose(table[chosen].J, costs[[0, 2, 5]], rtol=1e-9)


def made_up(guesses: int, seed: int) -> pd.DataFrame:
    """Nine statistics that say nothing, of iterates of which a guess's are all nearly alike."""
    rng, rows = np.random.default_rng(seed), []
    for task, guess in itertools.product(("flip", "grasp"), range(guesses)):
        shared = rng.normal(size=len(STATISTICS) + 1)
        for _ in range(15):
            values = shared + 0.1 * rng.normal(size=len(shared))
            row = dict(zip([*STATISTICS, "exact wins"], values, strict=True))
            rows.append({"task": task, "descent": "exact", "guess": guess, "sigma": 0.01, **row})
    gains = {f"gain, {name}": 1.0 for name in ("exact", "saltation", "smoothed", "zeroth", "exact, 1 mm")}
    rest = {"exact wins, 1 mm": 1.0, "saltation wins": 1.0, "cosine, saltation": 1.0}
    return pd.DataFrame(rows).assign(**gains, **rest, wins="exact")


def both(table: pd.DataFrame) -> pd.Series:
    return Why().summary(table).set_index(["task", "descent"]).loc["both", "all"]


def test_the_best_of_nine_that_say_nothing_is_not_believed():
    """In the data that chose it, 120 iterates in all, it has a correlation that 120 independent ones have never."""
    found = both(made_up(4, 1))
    assert max(abs(found[f"rho {name}"]) for name in STATISTICS) > 0.5
    assert found.low < 0 < found.high
    assert found.chosen < 0.9


def test_what_predicts_is_chosen_and_keeps_its_correlation_on_guesses_held_out():
    table = made_up(10, 2)
    rng = np.random.default_rng(3)
    table["bias"] = -table["exact wins"] + 0.1 * rng.normal(size=len(table))
    found = both(table)
    assert found.predictor == "bias"
    assert found.chosen > 0.9
    assert found["rho bias"] < -0.95
    assert found["held out"] == pytest.approx(-found["rho bias"], abs=0.05)  # Less of it predicts a win.
    assert 0.8 < found.low < found["held out"] < found.high < 1
    choices = choose(table)
    assert most_predictive(choices) == "bias"
    assert len(choices) == RESAMPLES
    # A resample of 10 lacks each with a probability of 0.9^10.
    share = np.mean([len(choice.outside) for choice in choices]) / 10
    assert share == pytest.approx(0.9**10, abs=0.02)


def test_rank_correlations_are_spearmans_with_ties():
    values = np.random.default_rng(0).integers(0, 6, (40, 4)).astype(float)
    values[::7, 0] = np.inf
    expected = [spearmanr(values[:, i], values[:, 3]).statistic for i in range(3)]
    np.testing.assert_allclose(rank_correlations(values), expected, rtol=1e-12)
    values[:, 1] = 2
    assert rank_correlations(values)[1] == 0
