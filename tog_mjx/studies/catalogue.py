"""The studies, by name: what is run, with which settings. `quick` ones are small, and the tests' own."""

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any, NamedTuple

import pandas as pd

from tog_mjx.figures.profiles import draw_profiles
from tog_mjx.simulators import SIMULATORS
from tog_mjx.solve import step_size
from tog_mjx.studies.asymmetry import Asymmetry
from tog_mjx.studies.cell import BUDGET, Cell, updates_within
from tog_mjx.studies.methods import METHODS
from tog_mjx.studies.quirks import released_quirks
from tog_mjx.studies.study import Comparison, DrawnComparison, Study
from tog_mjx.studies.why import Why
from tog_mjx.tasks import TASKS, get_task

ON_MJX = ("exact, plain", "exact, adam", "stochastic, plain", "zeroth order, adam", "CMA-ES", "solve")
"""The methods compared on MJX too, which simulates a hundredth of what `penalty` does in the same time."""
NOISES = (0.0, 1e-4, 1e-3, 1e-2, 3e-2, 1e-1)
"""Standard deviations of the initial guess, in m."""


class Grid(NamedTuple):
    """Step sizes and sigmas (m), all combinations."""

    steps: tuple[float, ...]
    sigmas: tuple[float, ...]


def candidates(name: str, method: str) -> Grid:
    """The settings among which a method's are chosen."""
    estimator, _, rule = method.partition(", ")
    by_rule = {"plain": (0.02, 0.1, 0.5), "clipped": (0.01, 0.03, 0.1), "": (0.0,)}
    steps = by_rule.get(rule, (0.003, 0.01, 0.03, 0.1))
    if method == "solve":
        steps = (step_size(get_task(name), int(BUDGET[name] / SIMULATORS["penalty"].GRADIENT_CHARGE)),)
    needs_no_sigma = estimator in ("exact", "differences", "solve")
    return Grid(steps, (0.0,) if needs_no_sigma else (0.01, 0.03, 0.1, 0.3))


def chosen(known: pd.DataFrame, name: str, method: str) -> Grid:
    """Of the tuned settings the one with most successes, then with the least median cost."""
    tuned = known[(known.task == name) & (known.method == method) & (known.stage == 0)]
    scores = tuned.groupby(["step", "sigma"]).agg(succeeded=("succeeded", "mean"), best=("best", "median"))
    step, sigma = scores.sort_values(["succeeded", "best"], ascending=[False, True]).index[0]
    return Grid((float(step),), (float(sigma),))


def _cell(name: str, method: str, members: Iterable[int], grid: Grid, simulator: str = "penalty", **more: Any) -> Cell:
    """A cell within the task's budget, from guesses 3 cm off unless told otherwise."""
    cell = Cell(name, simulator, method, 1, seeds=tuple(members), steps=grid.steps, sigmas=grid.sigmas)
    return updates_within(BUDGET[name], dataclasses.replace(cell, **{"noises": (0.03,), **more}))


def _tuned(known: pd.DataFrame) -> list[tuple[str, str]]:
    """The tasks and methods that were tuned."""
    return list(known[["task", "method"]].drop_duplicates().itertuples(index=False, name=None))


def seeds(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Table I, as it stands."""
    del known
    cells = []
    for simulator, name in itertools.product(("released", "penalty") if quick else SIMULATORS, TASKS):
        task = get_task(name)
        number = 8 if quick else 16 if simulator == "mjx" and name == "grasp" else 256
        for method, rule, members in (("exact, plain", task.exact, 1), ("stochastic, plain", task.stochastic, number)):
            updates = 1 + (min(rule.iterations, 100) if quick else rule.iterations)
            some = tuple(range(members))
            cells.append(Cell(name, simulator, method, updates, some, steps=(rule.step_size,), sigmas=(rule.sigma,)))
    return cells


def tuning(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Every setting of every method, on seeds that are not reported."""
    del known
    methods = ("exact, plain", "solve", "CMA-ES") if quick else METHODS
    seeds = range(1000, 1004 if quick else 1008)
    return [_cell(name, method, seeds, candidates(name, method)) for name, method in itertools.product(TASKS, methods)]


def fair_budget(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """The chosen settings on other seeds; on `mjx` those that `penalty` chose."""
    on_penalty = [_cell(*of, range(16 if quick else 100), chosen(known, *of)) for of in _tuned(known)]
    on_mjx = [_cell(*of, range(20), chosen(known, *of), "mjx") for of in _tuned(known) if of[1] in ON_MJX]
    return on_penalty if quick else on_penalty + on_mjx


def initial_guess(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """The chosen settings, from guesses ever farther off."""
    noises, some = ((0.0, 0.1), range(8)) if quick else (NOISES, range(64))
    return [_cell(name, method, some, chosen(known, name, method), noises=noises) for name, method in _tuned(known)]


def symmetry(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """The grasp with four free variables, and with two and their mirror images."""
    return [
        _cell(name, method, range(8 if quick else 64), chosen(known, name, method), symmetric=symmetric)
        for (name, method), symmetric in itertools.product(_tuned(known), (False, True))
        if name == "grasp"
    ]


def robustness(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """What each method found, under setpoint errors; and what it finds on the cost averaged over errors of 1 cm.

    The average of eight draws costs eight times as much, and is given it.
    """
    methods = ("solve",) if quick else ("exact, plain", "exact, adam", "zeroth order, adam", "CMA-ES", "solve")
    tested = (1e-3, 1e-2) if quick else (1e-4, 1e-3, 3e-3, 1e-2)
    return [
        dataclasses.replace(
            _cell(name, method, range(4 if quick else 16), chosen(known, name, method)), error=error, tested=tested
        )
        for (name, method), error in itertools.product(_tuned(known), (0.0, 0.01))
        if method in methods
    ]


def dimension(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Setpoints that change over time: the same settings and budget, ever more variables."""
    methods = ("solve",) if quick else ("exact, adam", "zeroth order, adam", "CMA-ES", "CR-FM-NES", "solve")
    return [
        _cell(name, method, range(4 if quick else 16), chosen(known, name, method), knots=knots)
        for (name, method), knots in itertools.product(_tuned(known), (1, 8) if quick else (1, 4, 16, 64, 128))
        if method in methods
    ]


_COMPARED = ("task", "simulator", "method")

STUDIES: dict[str, Study] = {
    "seeds": Comparison("Do Table I's two methods succeed by luck of the seed?", (seeds,), _COMPARED),
    "fair_budget": DrawnComparison(
        "At equal budgets, from guesses 3 cm off and with tuned settings: which method succeeds?",
        (tuning, fair_budget),
        (*_COMPARED, "step", "sigma"),
        draw_profiles,
    ),
    "initial_guess": Comparison(
        "How far may the initial guess be off?", (tuning, initial_guess), (*_COMPARED, "noise")
    ),
    "symmetry": Comparison("Does knowing the grasp's symmetry help?", (tuning, symmetry), (*_COMPARED, "symmetric")),
    "robustness": Comparison(
        "Does what was found survive setpoint errors?", (tuning, robustness), (*_COMPARED, "error")
    ),
    "dimension": Comparison("And with more variables?", (tuning, dimension), (*_COMPARED, "knots")),
    "asymmetry": Asymmetry(),
    "why": Why(),
    "released_quirks": released_quirks,
}
"""By name, as `scripts/run_study.py` takes it."""
