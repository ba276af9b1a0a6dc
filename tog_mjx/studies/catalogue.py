"""The studies, by name: what is run, with which settings. `quick` ones are small, and the tests' own."""

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tog_mjx.figures.basins import draw_basins
from tog_mjx.figures.profiles import draw_profiles
from tog_mjx.simulators import SIMULATORS
from tog_mjx.solve import step_size
from tog_mjx.studies.asymmetry import Asymmetry
from tog_mjx.studies.cell import BUDGET, Cell, updates_within
from tog_mjx.studies.methods import METHODS
from tog_mjx.studies.quirks import released_quirks
from tog_mjx.studies.study import Comparison, DrawnComparison, Study, TracedComparison
from tog_mjx.studies.why import Why
from tog_mjx.tasks import TASKS, get_task

ON_MJX = ("exact, plain", "exact, adam", "stochastic, plain", "zeroth order, adam", "CMA-ES", "solve")
"""The methods compared on MJX too, which simulates a hundredth of what `penalty` does in the same time."""
FEW_ON_MJX = ("exact, plain", "solve")
"""Those that the other studies run there, from 8 guesses."""
NOISES = (0.0, 1e-4, 1e-3, 1e-2, 3e-2, 1e-1)
"""Standard deviations of the initial guess, in m."""


class Grid(NamedTuple):
    """Step sizes and sigmas (m), all combinations."""

    steps: tuple[float, ...]
    sigmas: tuple[float, ...]


def candidates(name: str, method: str) -> Grid:
    """The settings among which a method's are chosen."""
    estimator, _, rule = method.partition(", ")
    by_rule = {"plain": (0.005, 0.02, 0.1, 0.5, 2.0, 10.0), "clipped": (0.01, 0.03, 0.1, 0.3), "": (0.0,)}
    steps = by_rule.get(rule, (0.003, 0.01, 0.03, 0.1, 0.3, 1.0))
    if estimator == "stochastic":  # Its update is, on average, sigma^2 times that of an exact gradient.
        steps = (0.1, 0.5, 2.0, 10.0, 50.0, 200.0)
    if method == "solve":
        steps = (step_size(get_task(name), int(BUDGET[name] / SIMULATORS["penalty"].GRADIENT_CHARGE)),)
    needs_no_sigma = estimator in ("exact", "differences", "solve")
    return Grid(steps, (0.0,) if needs_no_sigma else (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0))


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


def _few_on_mjx(quick: bool, known: pd.DataFrame, **more: Any) -> list[Cell]:
    return [
        _cell(*of, range(8), chosen(known, *of), "mjx", **more)
        for of in _tuned(known)
        if of[1] in FEW_ON_MJX and not quick
    ]


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
    on_penalty = [_cell(*of, some, chosen(known, *of), noises=noises) for of in _tuned(known)]
    return on_penalty + _few_on_mjx(quick, known, noises=NOISES[::2])


def symmetry(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """The grasp with four free variables, and with two and their mirror images."""
    known = known[known.task == "grasp"]
    some, cells = range(8 if quick else 64), []
    for symmetric in (False, True):
        cells += [_cell(*of, some, chosen(known, *of), symmetric=symmetric) for of in _tuned(known)]
        cells += _few_on_mjx(quick, known, symmetric=symmetric)
    return cells


def robustness(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """What each method found, under setpoint errors; and what it finds on the cost averaged over errors of 1 cm.

    The average of eight draws costs eight times as much, and is given it. On `mjx` the flip only.
    """
    methods = ("solve",) if quick else ("exact, plain", "exact, adam", "zeroth order, adam", "CMA-ES", "solve")
    some, tested = (range(4), (1e-3, 1e-2)) if quick else (range(16), (1e-4, 1e-3, 3e-3, 1e-2))
    known, cells = known[known.method.isin(methods)], []
    for error in (0.0, 0.01):
        on_penalty = [_cell(*of, some, chosen(known, *of)) for of in _tuned(known)]
        on_mjx = _few_on_mjx(quick, known[known.task == "flip"])
        cells += [dataclasses.replace(cell, error=error, tested=tested) for cell in on_penalty + on_mjx]
    return cells


def dimension(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Setpoints that change over time: the same settings and budget, ever more variables. On `mjx` the flip only."""
    methods = ("solve",) if quick else ("exact, adam", "zeroth order, adam", "CMA-ES", "CR-FM-NES", "solve")
    known, cells = known[known.method.isin(methods)], []
    for knots in (1, 8) if quick else (1, 4, 16, 64, 128):
        cells += [_cell(*of, range(4 if quick else 16), chosen(known, *of), knots=knots) for of in _tuned(known)]
        if knots <= 16:
            cells += _few_on_mjx(quick, known[known.task == "flip"], knots=knots)
    return cells


def basins(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """From all over the landscape's window: Table I's exact rule with its step size, and `solve`.

    As many updates for both: on the flip what the budget pays for, on the grasp Table I's, which are fewer.
    """
    del known
    size, cells = 9 if quick else 100, []
    for name, updates in (("flip", 25), ("grasp", 101)):
        task = get_task(name)
        for method, step in (("exact, plain", task.exact.step_size), ("solve", step_size(task, updates))):
            for part in np.array_split(np.arange(size**2), 1 if quick else 4):
                cells.append(Cell(name, "penalty", method, updates, tuple(part.tolist()), steps=(step,), window=size))
    return cells


_COMPARED = ("task", "simulator", "method")

STUDIES: dict[str, Study] = {
    "seeds": TracedComparison("Do Table I's two methods succeed by luck of the seed?", (seeds,), _COMPARED),
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
    "basins": DrawnComparison(
        "From where in the landscape's window does exact descent succeed?",
        (basins,),
        (*_COMPARED, "step"),
        draw_basins,
    ),
    "asymmetry": Asymmetry(),
    "why": Why(),
    "released_quirks": released_quirks,
}
"""By name, as `scripts/run_study.py` takes it."""
