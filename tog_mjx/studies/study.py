"""A study: cells to run, in stages that may depend on what came before, and one table of all their members.

Each finished part, a cell or whatever else a study computes, is a file, written atomically, so that a killed study
continues.
"""

import contextlib
import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binomtest

from tog_mjx.drawing.figures.bands import draw_bands
from tog_mjx.problems.library import LIBRARY, get_problem
from tog_mjx.running.storage import DamagedFileError, load_result, of_shapes, save_result
from tog_mjx.studies.cell import Cell, Found, compute


class Store:
    """A folder of finished parts, one file each, which all studies share. What is there and whole is read, but without
    `resume` only if this store has computed it."""

    def __init__(self, folder: Path, resume: bool):
        self.folder, self.resume = folder, resume
        self._computed: set[Path] = set()

    def path(self, name: str, settings: Mapping[str, Any]) -> Path:
        """One file for each name and set of settings. With `made_with` in them, another version of the program makes
        others."""
        digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:12]
        return self.folder / (re.sub(r"\W+", "-", name) + f"_{digest}.npz")

    def finish_part(
        self,
        name: str,
        settings: Mapping[str, Any],
        make: Callable[[], Mapping[str, np.ndarray]],
        shapes: Mapping[str, tuple[int | None, ...]] | None = None,
    ) -> dict[str, np.ndarray]:
        """Arrays by name: read, or made and kept. `settings` are JSON-able: all that the arrays depend on.

        What is kept but has not the arrays of `shapes` (None in one is any length) is damaged too.
        """
        path = self.path(name, settings)
        if self.resume or path in self._computed:
            with contextlib.suppress(FileNotFoundError, DamagedFileError):
                arrays = load_result(path)[0]
                if shapes is None:
                    return arrays
                return dict(zip(shapes, of_shapes(path, arrays, **shapes), strict=True))
        arrays = dict(make())
        save_result(path, arrays, {"settings": settings})
        self._computed.add(path)
        return arrays

    def finish_table(self, name: str, settings: Mapping[str, Any], make: Callable[[], pd.DataFrame]) -> pd.DataFrame:
        """As `finish_part`, of a table whose columns hold numbers, or text, or truth values."""
        # From the arrays, whether read or made: a column has one type either way.
        return pd.DataFrame(
            self.finish_part(
                name, settings, lambda: {column: np.array(values.tolist()) for column, values in make().items()}
            )
        )

    def finish(self, cell: Cell, report: Callable[[int], None] = lambda _: None) -> Found:
        """The cell's result: read, or computed and kept."""
        name = f"{cell.task}_{cell.simulator}_{cell.method}"
        make = lambda: compute(cell, report)._asdict()  # noqa: E731
        return Found(**self.finish_part(name, cell.settings(), make, cell.shapes))


class Study(Protocol):
    """A question; the table of all its runs, one row each; and the rows that answer, one a group."""

    @property
    def question(self) -> str: ...

    def run(self, quick: bool, store: Store, piece: Callable) -> pd.DataFrame:
        """`piece(name, total)` is a context that yields what reports progress."""

    def summary(self, table: pd.DataFrame) -> pd.DataFrame: ...


@runtime_checkable
class Drawn(Protocol):
    """A study that has a figure too."""

    def draw(self, quick: bool, store: Store, table: pd.DataFrame) -> Figure:
        """From the table of a run, and from what the run has left in the store."""


Stage = Callable[[bool, pd.DataFrame], list[Cell]]


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A study of descents. Each of the `stages` gives cells, from whether it is to be quick and from the table of the
    stages before; `groups` are the columns whose combinations are compared. Implements `Study`."""

    question: str
    stages: tuple[Stage, ...]
    groups: tuple[str, ...]

    def run(self, quick: bool, store: Store, piece: Callable) -> pd.DataFrame:
        tables: list[pd.DataFrame] = []
        for stage, cells in enumerate(self.stages):
            for cell in cells(quick, pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()):
                name = ", ".join([f"{cell.task} {cell.simulator}", cell.method, *(value for _, value in cell.options)])
                with piece(name + (f", {cell.knots} knots" if cell.knots > 1 else ""), cell.updates) as report:
                    tables.append(rows(cell, store.finish(cell, report), stage))
        return pd.concat(tables, ignore_index=True)

    def summary(self, table: pd.DataFrame) -> pd.DataFrame:
        """Of the last stage: success of the best iterate, with its Wilson interval (95 %) where the runs are a random
        sample, and of the last iterate; medians, that of the evaluations to success over the runs that succeeded."""
        last = table[table.stage == table.stage.max()]
        found = [
            {**dict(zip(self.groups, group, strict=True)), **_outcome(members)}
            for group, members in last.groupby(list(self.groups), sort=False)
        ]
        return pd.DataFrame(found).dropna(axis="columns", how="all")


@dataclasses.dataclass(frozen=True)
class DrawnComparison(Comparison):
    """With a `picture` of the last stage's runs. Implements `Drawn`."""

    picture: Callable[[pd.DataFrame], Figure]

    def draw(self, quick: bool, store: Store, table: pd.DataFrame) -> Figure:
        del quick, store
        return self.picture(table[table.stage == table.stage.max()])


@dataclasses.dataclass(frozen=True)
class TracedComparison(Comparison):
    """With J against iteration in the last stage, over the members that start at the paper's guess. Implements
    `Drawn`."""

    def draw(self, quick: bool, store: Store, table: pd.DataFrame) -> Figure:
        cells = self.stages[-1](quick, table[table.stage < table.stage.max()])
        from_the_papers = [cell for cell in cells if cell.noises == (0.0,) and not cell.window]
        costs = {(cell.task, cell.simulator, cell.method): store.finish(cell).costs for cell in from_the_papers}
        return draw_bands(costs, {name: float(make().success or 0) for name, make in LIBRARY.items()})


def _outcome(members: pd.DataFrame) -> dict[str, Any]:
    # The points of a window are a grid, and without any noise all runs are the same.
    is_sample = (members.window == 0).all() and ((members.noise > 0) | (members.sigma > 0)).all()
    interval = binomtest(int(members.succeeded.sum()), len(members)).proportion_ci(method="wilson")
    return {
        "members": len(members),
        "updates": members.updates.max(),
        "success": members.succeeded.mean(),
        "low": interval.low if is_sample else np.nan,
        "high": interval.high if is_sample else np.nan,
        "success, last": members.succeeded_last.mean(),
        "J best": members.best.median(),
        "J last": members["last"].median(),
        "evaluations, median of successes": members["evaluations to success"].median(),
        **{name: members[name].median() for name in members.columns if name.startswith("J ") and " at " in name},
    }


def rows(cell: Cell, found: Found, stage: int) -> pd.DataFrame:
    """One row a member: its settings, its costs, and what it took. Each of the simulator's options is a column."""
    costs = np.where(np.isfinite(found.costs), found.costs, np.inf)
    good = costs <= get_problem(cell.task).success
    evaluations = np.where(good.any(axis=1), (good.argmax(axis=1) + 1) * cell.charge, np.nan)
    table = pd.DataFrame(cell.members)
    for name in ("task", "simulator", "method", "knots", "symmetric", "error", "window"):
        table[name] = getattr(cell, name)
    for option, value in cell.options:
        table[option] = value
    table = table.assign(
        stage=stage,
        updates=cell.updates,
        charge=cell.charge,
        first=costs[:, 0],
        best=costs.min(axis=1),
        last=costs[:, -1],
        best_at=costs.argmin(axis=1),
        succeeded=good.any(axis=1),
        succeeded_last=good[:, -1],
    )
    table["evaluations to success"] = evaluations
    for error, tried in zip(cell.tested, np.moveaxis(found.tried, 1, 0), strict=True):
        for quantile in (0.5, 0.9):
            table[f"J {quantile:.0%} at {1000 * error:g} mm"] = np.quantile(tried, quantile, axis=1)
    return table
