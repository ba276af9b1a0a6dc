"""The report: the paper's question, and its answer, in one sentence a task, computed from the runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tog_mjx.drawing.report import Section, Table, write_page
from tog_mjx.paper.comparison import METHODS, Run, table_rows
from tog_mjx.paper.gallery import table_1
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import Descent

QUESTION = (
    "To optimise a motion through contact by gradient descent, should one follow the exact gradient of the simulation, "
    "or a stochastic estimate of it?"
)
_LEADING = ("mjx", "penalty", "released")
"""The simulator whose numbers are quoted is the first of these that ran."""
_PLATEAU = 0.9
"""A method that stays above that share of the first cost has not moved the box."""


def write_report(
    path: Path,
    runs: Mapping[Run, Descent],
    sections: Sequence[Section],
    scenarios: Sequence[Mapping[str, Any]],
    tasks: Sequence[Task],
) -> None:
    """Writes the page, atomically: one file that needs nothing else, and no network.

    Args:
      runs: whose numbers stand beside the published ones.
      scenarios: of `tog_mjx.paper.scenario`, the interactive part.
      tasks: whose settings stand at the end.
    """
    rows = table_rows(runs)
    numbers = Table(
        ["descent", "simulator", "first", "last", "best", "best at"],
        [[row.descent, row.source, *(f"{cost:.4f}" for cost in row.costs), row.best_at] for row in rows],
        "Cost J: of the initial guess, of the last iterate, and of the best one",
        ["published" if row.source == "published" else "" for row in rows],
    )
    first = Section("This run beside the published numbers", table=numbers)
    last = Section("Settings (Table I)", table=table_1(tasks))
    title, command = "A Tale of Two Gradients, on MuJoCo MJX", "tog reproduce"
    blocks = [first, *sections, last]
    write_page(path, title, QUESTION, answers(runs), blocks, scenarios=scenarios, footer=command)


def answers(runs: Mapping[Run, Descent]) -> list[str]:
    """A sentence for each task that both methods ran on."""
    found = []
    for task in dict.fromkeys(run.task for run in runs):
        pairs = {}
        for simulator in _LEADING:
            pair = {r.method: d for r, d in runs.items() if (r.task, r.simulator) == (task, simulator)}
            if set(pair) == set(METHODS):
                pairs[simulator] = pair
        if pairs:
            found.append(_answer(task, pairs))
    return found


def _answer(task: str, pairs: Mapping[str, Mapping[str, Descent]]) -> str:
    simulator, pair = next(iter(pairs.items()))
    winner = _winner(pair)
    loser = next(method for method in METHODS if method != winner)
    best, other = pair[winner], pair[loser]
    first = other.costs[0]
    if other.costs.min() > _PLATEAU * first:
        rest = f"while the {loser} one never leaves the plateau (best {other.costs.min():.3f}, from {first:.3f})"
    else:
        rest = f"and the {loser} one gets down to {other.costs.min():.3f} at update {other.best_iteration}"
    agreeing = [name for name in pairs if _winner(pairs[name]) == winner]
    agreement = "" if len(pairs) == 1 else f"; {winner} descent finds the lower cost on {_on(agreeing, len(pairs))}"
    return (
        f"On the {task}, {winner} descent on {simulator} reaches J = {best.costs.min():.3f} at update "
        f"{best.best_iteration} of {best.iterations}, {rest}{agreement}."
    )


def _winner(pair: Mapping[str, Descent]) -> str:
    return min(METHODS, key=lambda method: pair[method].costs.min())


def _on(names: list[str], total: int) -> str:
    if len(names) < total:
        return f"{', '.join(names)} only"
    return "both simulators" if total == 2 else f"all {total} simulators"
