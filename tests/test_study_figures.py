"""Figures of studies show the runs: quantiles over seeds, and basins over guesses."""

import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import PolyCollection, QuadMesh

from tog_mjx.drawing.figures.bands import QUANTILES, draw_bands, quantiles
from tog_mjx.engines.objective import objective
from tog_mjx.paper.questions.catalogue import basins_figure
from tog_mjx.paper.tasks import get_task

COSTS = np.array([[2.0, 1.0, 0.5], [2.0, 3.0, 0.1], [2.0, 2.0, 0.3], [2.0, 0.5, 4.0]])


def test_quantiles_are_numpys_and_leave_out_what_is_not_finite():
    np.testing.assert_allclose(quantiles(COSTS), np.quantile(COSTS, QUANTILES, axis=0))
    np.testing.assert_allclose(quantiles(COSTS)[2], [2.0, 1.5, 0.4])
    broken = np.vstack([COSTS, [np.inf, np.nan, 0.0]])
    np.testing.assert_allclose(quantiles(broken)[:, :2], quantiles(COSTS)[:, :2])


def test_bands_show_one_run_as_a_line_and_many_as_quantiles():
    traces = {
        ("flip", "penalty", "exact, plain"): COSTS[:1],
        ("flip", "mjx", "stochastic, plain"): COSTS,
        ("grasp", "penalty", "stochastic, plain"): np.ones((4, 201)),
    }
    figure = draw_bands(traces, {"flip": 0.1, "grasp": 0.2})
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    assert len(panels) == 4
    labels = ["exact gradient", "success", "stochastic gradient, median", "10 to 90 %", "all seeds"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == labels
    line = panels["Box flip on penalty"]
    np.testing.assert_array_equal(line.lines[0].get_ydata(), COSTS[0])
    assert not line.collections
    bands = panels["Box flip on mjx"]
    np.testing.assert_allclose(np.asarray(bands.lines[0].get_ydata(), float), np.median(COSTS, axis=0))
    for band, outer in zip(bands.collections, ([0.1, 0.9], [0.0, 1.0]), strict=True):
        assert isinstance(band, PolyCollection)
        x, y = np.asarray(band.get_paths()[0].vertices).T
        for i, (low, high) in enumerate(np.quantile(COSTS, outer, axis=0).T):
            np.testing.assert_allclose([y[x == i].min(), y[x == i].max()], [low, high])
    assert [axes.get_xscale() for axes in panels.values()] == ["linear", "linear", "symlog", "symlog"]


def test_basins_show_the_landscape_what_was_found_and_where_it_succeeded():
    seeds = np.random.default_rng(0).permutation(9)
    runs = [{"task": "flip", "method": of, "seed": seed, "first": 10.0 + seed, "best": seed / (1 + (of == "b")),
             "succeeded": bool(seed > 5)} for of in "ab" for seed in seeds]  # fmt: skip
    figure = basins_figure(pd.DataFrame(runs))
    panels = {axes.get_title(loc="left"): [found for found in axes.collections if isinstance(found, QuadMesh)]
              for axes in figure.axes}  # fmt: skip
    expected = np.arange(9.0).reshape(3, 3)
    np.testing.assert_array_equal(panels["Box flip: J"][0].get_array(), 10 + expected)
    np.testing.assert_array_equal(panels["a: 33%"][0].get_array(), expected)
    np.testing.assert_array_equal(panels["b: 33%"][0].get_array(), expected / 2)
    for name in ("a: 33%", "b: 33%"):
        np.testing.assert_array_equal(np.ma.getmaskarray(np.ma.asarray(panels[name][1].get_array())), expected <= 5)


@pytest.fixture(scope="module")
def basins(run_script, tmp_path_factory) -> tuple[pd.DataFrame, pd.DataFrame]:
    folder = tmp_path_factory.mktemp("basins")
    assert run_script("run_study.py", "basins", "--quick", "--out", folder)[0] == 0
    assert (folder / "basins_quick" / "basins.png").is_file()
    return tuple(pd.read_csv(folder / "basins_quick" / f"{name}.csv") for name in ("table", "summary"))


def test_the_flip_succeeds_from_nearly_everywhere_and_the_grasp_does_not(basins):
    success = basins[1].set_index(["task", "method"]).success
    assert success["flip", "solve"] > success["flip", "exact, plain"] > 0.7
    assert success["flip", "solve"] > 0.95
    assert 0.3 < success["grasp", "exact, plain"] < 0.6
    assert 0.3 < success["grasp", "solve"] < 0.6
    assert "low" not in basins[1]  # A grid is no sample.


@pytest.mark.parametrize("name", ["flip", "grasp"])
def test_first_costs_are_the_landscape(basins, name):
    runs = basins[0][(basins[0].task == name) & (basins[0].method == "solve")].sort_values("seed")
    size = math.isqrt(len(runs))
    task, cost = get_task(name), objective(name, "penalty")
    for at in (0, size + 2, len(runs) - 1):
        assert runs["first"].iloc[at] == pytest.approx(float(cost(task.expand(task.plane.grid(size)[at]))), rel=1e-9)


def test_the_papers_guess_lies_in_the_basin_of_the_flip(basins):
    runs = basins[0][(basins[0].task == "flip") & (basins[0].seed == 2 * 9 + 4)]  # z = 0.25, x = 0.
    assert len(runs) == 2
    assert runs.succeeded.all()
