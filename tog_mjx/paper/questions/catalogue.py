"""The studies, by name: what is run, with which settings. `quick` ones are small, and the tests' own."""

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.basins import View, draw_basins
from tog_mjx.drawing.figures.profiles import draw_profiles
from tog_mjx.engines import SIMULATORS, gradient_charge
from tog_mjx.paper.outcomes import LEVELS
from tog_mjx.paper.questions.asymmetry import Asymmetry
from tog_mjx.paper.questions.quirks import released_quirks
from tog_mjx.paper.questions.why import Why
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.solving.methods import METHODS, RULES
from tog_mjx.solving.solve import step_size
from tog_mjx.studies.cell import Cell, updates_within
from tog_mjx.studies.study import Comparison, DrawnComparison, Study, TracedComparison

ON_MJX = ("exact, plain", "exact, adam", "stochastic, plain", "zeroth order, adam", "CMA-ES", "solve")
"""The methods compared on MJX too, which simulates a hundredth of what `penalty` does in the same time."""
FEW_ON_MJX = ("exact, plain", "solve")
"""Those that the other studies run there, from 8 guesses."""
BETWEEN_JUMPS = tuple(name for name, method in METHODS.items() if method.differentiation is None)
"""The methods of all studies but that of three gradients."""
TWINS = tuple((f"exact, {rule}" if rule != "solve" else rule, f"saltation, {rule}") for rule in RULES)
"""The same update rule with the gradient between two jumps, and with the one that has them."""
SOLVERS = TWINS[-1]
SAMPLING = ("zeroth order, adam", "CMA-ES")
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
    if "solve" in (estimator, rule):
        charge = gradient_charge("penalty", METHODS[method].differentiation)
        steps = (step_size(get_task(name), int(get_task(name).budget / charge)),)
    needs_no_sigma = estimator in ("exact", "saltation", "differences", "solve")
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
    return updates_within(get_task(name).budget, dataclasses.replace(cell, **{"noises": (0.03,), **more}))


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
    return _tuning(quick, ("exact, plain", "solve", "CMA-ES") if quick else BETWEEN_JUMPS)


def tuning_of_three(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """The same of the methods that differ in their gradient alone, and of two that sample."""
    del known
    pairs = [method for twins in TWINS for method in twins]
    return _tuning(quick, ("solve", "saltation, solve") if quick else (*pairs, *SAMPLING))


def _tuning(quick: bool, methods: Iterable[str]) -> list[Cell]:
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
    return _all_over(9 if quick else 100, 1 if quick else 4, ("exact, plain", "solve"))


def _all_over(size: int, parts: int, methods: Iterable[str]) -> list[Cell]:
    """Each method with Table I's exact step, or with what `solve` takes for as many updates."""
    cells = []
    for (name, updates), method in itertools.product((("flip", 25), ("grasp", 101)), methods):
        task = get_task(name)
        step = step_size(task, updates) if method in SOLVERS else task.exact.step_size
        for part in np.array_split(np.arange(size**2), parts):
            cells.append(Cell(name, "penalty", method, updates, tuple(part.tolist()), steps=(step,), window=size))
    return cells


def three_gradients(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Between two jumps, with the jumps, or from samples.

    The chosen settings from guesses ever farther off, those of 3 cm with what was found under setpoint errors; then the
    two gradients alone: Table I's exact rule, all of the window, mirrored setpoints, more variables, and the cost
    averaged over errors. On `mjx` the grasp with the jumps.
    """
    some, errors, cells = range(4 if quick else 64), (1e-4, 1e-3, 3e-3, 1e-2), []
    for of in _tuned(known):
        grid, is_tried = chosen(known, *of), of[1] in (*TWINS[1], *SOLVERS, "CMA-ES")
        cells.append(_cell(*of, some, grid, tested=errors if is_tried else ()))
        if quick:
            continue
        cells.append(_cell(*of, range(32), grid, noises=(1e-3, 1e-1)))
        if of[0] == "grasp" and of[1] in (*TWINS[0], *TWINS[1], *SOLVERS):
            cells.append(_cell(*of, range(32), grid, symmetric=True))
        if of[1] in SOLVERS:
            cells.append(dataclasses.replace(_cell(*of, range(16), grid, tested=errors), error=0.01))
            cells += [_cell(*of, range(16), grid, knots=knots) for knots in (4, 16, 128)]
        if of == ("grasp", SOLVERS[1]):
            cells.append(_cell(*of, range(8), grid, "mjx"))
    return _of_table_1(quick) + _all_over(5 if quick else 30, 1, (*TWINS[0], *SOLVERS)) + cells


def _of_table_1(quick: bool) -> list[Cell]:
    """Table I from the paper's guess, and its exact rule with either gradient from others."""
    cells = []
    for name in TASKS:
        task, members = get_task(name), tuple(range(4 if quick else 64))
        rule = task.stochastic
        updates = 1 + (min(rule.iterations, 100) if quick else rule.iterations)
        steps, sigmas = (rule.step_size,), (rule.sigma,)
        cells.append(Cell(name, "penalty", "stochastic, plain", updates, members, steps=steps, sigmas=sigmas))
        for method in TWINS[0]:
            cell = Cell(name, "penalty", method, 1 + task.exact.iterations, steps=(task.exact.step_size,))
            cells.append(cell)
            if not quick:
                cells.append(dataclasses.replace(cell, seeds=tuple(range(32)), noises=(1e-4, 3e-2)))
    if not quick:  # The last one is that of the grasp with the jumps.
        cells.append(dataclasses.replace(cell, simulator="mjx", noises=(0.0, 1e-4, 1e-3)))
    return cells


_COMPARED = ("task", "simulator", "method")


def basins_figure(table: pd.DataFrame) -> Figure:
    """`draw_basins` of tasks."""
    tasks = [get_task(name) for name in table.task.unique()]
    return draw_basins(
        table, {task.name: View(task.window, task.initial_guess[:2], LEVELS[task.name][-1]) for task in tasks}
    )


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
        basins_figure,
    ),
    "three_gradients": TracedComparison(
        "Which of the findings depend on the jumps that the exact gradient does not see?",
        (tuning_of_three, three_gradients),
        (*_COMPARED, "updates", "step", "sigma", "noise", "knots", "symmetric", "error", "window"),
    ),
    "asymmetry": Asymmetry(),
    "why": Why(),
    "released_quirks": released_quirks,
}
"""By name, as `tog study` takes it."""
