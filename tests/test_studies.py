"""Studies: cells are the descents they claim to be, and tables hold known facts."""

import contextlib
import dataclasses
import itertools
import math
import sys

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from tog_mjx.drawing.figures.profiles import draw_profiles
from tog_mjx.engines.objective import objective
from tog_mjx.paper.comparison import Run
from tog_mjx.paper.comparison import compute as compute_run
from tog_mjx.paper.questions import catalogue
from tog_mjx.paper.questions.catalogue import candidates, chosen
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import load_result, save_result
from tog_mjx.solving.methods import METHODS, Settings
from tog_mjx.studies.cell import Cell, Found, compute, updates_within
from tog_mjx.studies.study import Comparison, Store, rows


@pytest.fixture(scope="module")
def table_1() -> Cell:
    return Cell("flip", "penalty", "exact, plain", 6, seeds=(3, 4), noises=(0.0, 0.01), steps=(0.1,))


def test_a_cell_is_the_descent_of_the_comparison(table_1):
    found = compute(table_1)
    descent = compute_run(Run("penalty", "flip", "exact"))
    for member in (0, 2):
        np.testing.assert_allclose(found.costs[member], descent.costs, rtol=1e-9)
        np.testing.assert_allclose(found.best[member], descent.best, rtol=1e-9)
        np.testing.assert_allclose(found.last[member], descent.last, rtol=1e-9)


def test_a_strategy_without_its_library_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "evosax.algorithms", None)
    with pytest.raises(InputError, match="CMA_ES needs the package evosax; install it with: pip install evosax"):
        METHODS["CMA-ES"].bind(lambda u: u @ u, Settings(jnp.array(1.0), jnp.array(0.1)), 2)


def test_equal_seeds_have_equal_guesses_whatever_the_method(table_1):
    other = Cell("flip", "penalty", "stochastic, plain", 1, (3, 4), (0.0, 0.01), (0.1,), (0.5,))
    first, same = compute(table_1).first, compute(other).first
    np.testing.assert_array_equal(first, same)
    np.testing.assert_array_equal(first[[0, 2]], np.tile(get_task("flip").initial_guess, (2, 1)))
    assert np.abs(first[1] - first[3]).min() > 1e-4
    assert np.abs(first - first[0]).max() < 0.05


@pytest.mark.parametrize("method", catalogue.BETWEEN_JUMPS)
def test_every_method_lowers_the_cost_and_remembers_the_best(method):
    grid = candidates("flip", method)
    steps, sigmas = grid.steps[2:3] or grid.steps, grid.sigmas[-2:-1] or grid.sigmas
    cell = Cell("flip", "penalty", method, 12, (0, 1), steps=steps, sigmas=sigmas)
    found = compute(cell)
    cost = objective("flip", "penalty")
    assert (found.costs.min(axis=1) < found.costs[:, 0]).all()
    for best, costs in zip(found.best, found.costs, strict=True):
        np.testing.assert_allclose(cost(best), costs.min(), rtol=1e-9)


def test_a_budget_buys_updates_by_what_they_use():
    def updates(method: str, name: str = "grasp", **more) -> int:
        return updates_within(1000, Cell(name, "penalty", method, 1, **more)).updates

    assert updates("exact, plain") == 250
    assert updates("saltation, plain") == 200
    assert updates("stochastic, plain") == 500
    assert updates("differences, adam") == math.floor(1000 / 9)
    assert updates("differences, adam", symmetric=True) == 200
    assert updates("differences, adam", knots=8) == math.floor(1000 / 65)
    assert updates("exact, plain", error=0.01) == math.floor(1000 / 32)
    assert updates("CMA-ES") == 125


def test_restricted_setpoints_are_mirror_images():
    cell = Cell("grasp", "penalty", "exact, plain", 3, (0, 1), (0.02,), (0.5,), knots=2, symmetric=True)
    for found in compute(cell)[1:4]:
        left, right = np.moveaxis(found.reshape(2, 2, 2, 2), 2, 0)
        np.testing.assert_array_equal(right, left * [-1, 1])


def test_guesses_of_a_window_are_the_points_of_its_landscape():
    task, seeds = get_task("grasp"), (40, 3, 70)
    points = task.plane.grid(9)[list(seeds)]
    for symmetric in (False, True):
        cell = Cell("grasp", "penalty", "exact, plain", 1, seeds, steps=(0.5,), symmetric=symmetric, window=9)
        np.testing.assert_array_equal(compute(cell).first, [task.expand(point) for point in points])


def test_a_descent_from_the_windows_point_at_the_papers_guess_is_table_1s(table_1):
    at = 2 * 9 + 4  # z = 0.25, x = 0.
    cell = dataclasses.replace(table_1, seeds=(at,), noises=(0.0,), window=9)
    np.testing.assert_allclose(compute(cell).costs[0], compute(table_1).costs[0], rtol=1e-12)


@pytest.mark.parametrize("study", ["fair_budget", "initial_guess", "symmetry", "robustness", "dimension"])
def test_on_mjx_run_the_methods_that_are_said_to(study):
    settings = [("flip", "grasp"), METHODS, (0,), (0.1,), (0.03,), (True,), (0.1,)]
    columns = ["task", "method", "stage", "step", "sigma", "succeeded", "best"]
    known = pd.DataFrame(itertools.product(*settings), columns=columns)
    cells = [cell for cell in getattr(catalogue, study)(False, known) if cell.simulator == "mjx"]
    found = {(cell.task, cell.method) for cell in cells}
    tasks = {"symmetry": ("grasp",), "robustness": ("flip",), "dimension": ("flip",)}.get(study, ("flip", "grasp"))
    methods = {"fair_budget": catalogue.ON_MJX, "dimension": ("solve",)}.get(study, catalogue.FEW_ON_MJX)
    assert found == set(itertools.product(tasks, methods))
    assert {len(cell.seeds) for cell in cells} == {20 if study == "fair_budget" else 8}
    assert {cell.simulator for cell in getattr(catalogue, study)(True, known)} == {"penalty"}


def test_setpoint_errors_are_tried_on_the_best():
    cell = Cell("flip", "penalty", "exact, plain", 3, steps=(0.1,), tested=(0.0, 1e-6, 0.1))
    found = compute(cell)
    assert found.tried.shape == (1, 3, 256)
    np.testing.assert_allclose(found.tried[0, 0], found.costs.min(), rtol=1e-9)
    assert 0 < np.ptp(found.tried[0, 1]) < np.ptp(found.tried[0, 2])


def test_tuning_takes_most_successes_then_the_least_cost():
    known = pd.DataFrame(
        [("flip", "a", 0, step, sigma, won, best) for step, sigma, won, best in
         [(1.0, 0.1, True, 0.09), (1.0, 0.1, False, 0.5), (2.0, 0.1, True, 0.08), (2.0, 0.1, True, 0.07),
          (2.0, 0.3, True, 0.01), (2.0, 0.3, True, 0.02)]],
        columns=["task", "method", "stage", "step", "sigma", "succeeded", "best"],
    )  # fmt: skip
    assert chosen(known, "flip", "a") == ((2.0,), (0.3,))


def test_a_summary_counts_with_wilson_intervals(tmp_path):
    cell = Cell("flip", "penalty", "exact, plain", 12, tuple(range(8)), noises=(0.1,), steps=(0.1,))
    study = Comparison("?", (lambda quick, known: [cell] * (quick or known.empty),), ("task",))
    silent = contextlib.nullcontext(lambda _: None)
    table = study.run(True, Store(tmp_path, resume=False), lambda *_: silent)
    (row,) = study.summary(table).to_dict("records")
    costs = compute(cell).costs
    won = (costs <= 0.1).any(axis=1)
    n, p, z = 8, won.mean(), 1.959963984540054
    assert 0 < p < 1
    assert (row["members"], row["success"]) == (n, p)
    spread = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    expected = (p + z**2 / (2 * n) + np.array([-spread, spread])) / (1 + z**2 / n)
    np.testing.assert_allclose([row["low"], row["high"]], expected, rtol=1e-12)
    # Of the runs that succeeded alone.
    first = (costs[won] <= 0.1).argmax(axis=1)
    assert row["evaluations, median of successes"] == np.median(4 * (1 + first))


@pytest.mark.parametrize(
    ("of", "is_sample"),
    [
        ({"method": "exact, plain"}, False),
        ({"method": "exact, plain", "noises": (0.0, 0.03)}, False),
        ({"method": "exact, plain", "window": 3}, False),
        ({"method": "exact, plain", "noises": (0.01,)}, True),
        ({"method": "stochastic, plain", "sigmas": (0.5,)}, True),
        ({"method": "stochastic, plain", "sigmas": (0.5,), "window": 3}, False),
    ],
)
def test_only_a_random_sample_has_an_interval(of, is_sample):
    """Not the points of a grid, nor runs that are all the same."""
    cell = Cell(**{"task": "flip", "simulator": "penalty", "updates": 1, "seeds": (0, 1), "steps": (0.1,), **of})
    size = len(cell.members)
    nowhere = np.zeros((size, 2))
    found = Found(np.ones((size, 1)), nowhere, nowhere, nowhere, np.zeros((size, 0, 256)))
    row = Comparison("?", (), ("task",)).summary(rows(cell, found, 0)).to_dict("records")[0]
    assert ("low" in row, "high" in row) == (is_sample, is_sample)


def test_a_damaged_cell_is_computed_again_and_a_whole_one_is_not(tmp_path, table_1):
    before = Store(tmp_path, resume=False)
    found = before.finish(table_1)
    (path,) = tmp_path.iterdir()
    made = path.stat().st_mtime_ns
    np.testing.assert_array_equal(Store(tmp_path, resume=True).finish(table_1).costs, found.costs)
    assert path.stat().st_mtime_ns == made
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    path.write_bytes(damaged)
    np.testing.assert_array_equal(Store(tmp_path, resume=True).finish(table_1).costs, found.costs)
    assert path.stat().st_mtime_ns != made
    assert path.read_bytes() != bytes(damaged)


def test_a_kept_cell_that_is_not_the_cells_is_computed_again(tmp_path, table_1):
    found = Store(tmp_path, resume=False).finish(table_1)
    (path,) = tmp_path.iterdir()
    whole = found._asdict()
    for name, other in (("costs", found.costs[:, :-1]), ("best", found.best * 1j), ("tried", None)):
        save_result(path, {key: value for key, value in {**whole, name: other}.items() if value is not None}, {})
        again = Store(tmp_path, resume=True).finish(table_1)
        for key, value in whole.items():
            np.testing.assert_array_equal(getattr(again, key), value)
        np.testing.assert_array_equal(load_result(path)[0]["costs"], found.costs)


def test_quick_seeds_show_what_the_paper_says(run_script, tmp_path):
    status, said, _ = run_script("run_study.py", "seeds", "--quick", "--out", tmp_path)
    assert status == 0
    assert "Do Table I's two methods succeed" in said
    summary = pd.read_csv(tmp_path / "seeds_quick" / "summary.csv").set_index(["task", "simulator", "method"])
    for simulator in ("released", "penalty"):
        assert summary.success["grasp", simulator, "exact, plain"] == 1
        assert summary.success["grasp", simulator, "stochastic, plain"] == 0
    assert summary["success, last"]["grasp", "penalty", "exact, plain"] == 0  # Thrown out of the basin again.
    assert summary.success["flip", "penalty", "exact, plain"] == 0  # 0.150 after Table I's five iterations.
    table = pd.read_csv(tmp_path / "seeds_quick" / "table.csv")
    assert len(table) == 4 * (1 + 8)
    kept = {path.name.rpartition("_")[0]: load_result(path)[0] for path in (tmp_path / "cells").glob("*.npz")}
    assert len(kept) == 8
    grasp = table[(table.task == "grasp") & (table.simulator == "penalty") & (table.method == "stochastic, plain")]
    costs = kept["grasp_penalty_stochastic-plain"]["costs"]
    np.testing.assert_array_equal(grasp[["first", "best", "last"]].T, [costs[:, 0], costs.min(axis=1), costs[:, -1]])


def test_a_profile_rises_where_runs_succeeded():
    runs = pd.DataFrame({"task": "flip", "simulator": "penalty", "method": list("aaab"), "updates": 10, "charge": 4.0})
    runs["evaluations to success"] = [8.0, np.nan, 20.0, np.nan]
    (axes,) = draw_profiles(runs).axes
    rising, flat = axes.get_lines()
    assert np.array(rising.get_data()).T.tolist() == [[0, 0], [8, 1 / 3], [20, 2 / 3], [40, 2 / 3]]
    assert np.array(flat.get_data())[1].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["luck"], "invalid choice: 'luck'"), (["seeds", "--out", "/dev/null/x"], "cannot be written")],
)
def test_bad_input_is_one_line_and_status_2(run_script, arguments, message):
    status, said, complaint = run_script("run_study.py", *arguments)
    assert (status, said) == (2, "")
    assert message in complaint
    assert complaint.count("\n") == 1
