"""A study: cells to run, in stages that may depend on what came before, and one table of all their members.

Each finished cell is a file, written atomically, so that a killed study continues.
"""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from tog_mjx.storage import DamagedFileError, load_result, save_result
from tog_mjx.studies.cell import SUCCESS, Cell, Found, compute

Stage = Callable[[bool, pd.DataFrame], list[Cell]]


class Study(NamedTuple):
    """A `question`, and the `stages` that answer it: each gives cells, from whether it is to be quick and the table of
    the stages before. `groups` are the columns whose combinations are compared."""

    question: str
    stages: tuple[Stage, ...]
    groups: tuple[str, ...]


class Store:
    """A folder of finished cells, one file each, which all studies share. What is there and whole is read, but without
    `resume` only if this store has computed it."""

    def __init__(self, folder: Path, resume: bool):
        self.folder, self.resume = folder, resume
        self._computed: set[Path] = set()

    def path(self, cell: Cell) -> Path:
        """One file for each set of settings; another version of the program makes others."""
        digest = hashlib.sha256(json.dumps(cell.settings(), sort_keys=True).encode()).hexdigest()[:12]
        method = cell.method.replace(", ", "-").replace(" ", "-")
        return self.folder / f"{cell.task}_{cell.simulator}_{method}_{digest}.npz"

    def finish(self, cell: Cell, report: Callable[[int], None] = lambda _: None) -> Found:
        """The cell's result: read, or computed and kept."""
        path = self.path(cell)
        if self.resume or path in self._computed:
            with contextlib.suppress(FileNotFoundError, DamagedFileError, TypeError):
                return Found(**load_result(path)[0])
        found = compute(cell, report)
        save_result(path, found._asdict(), {"settings": cell.settings()})
        self._computed.add(path)
        return found


def rows(cell: Cell, found: Found, stage: int) -> pd.DataFrame:
    """One row a member: its settings, its costs, and what it took."""
    costs = np.where(np.isfinite(found.costs), found.costs, np.inf)
    good = costs <= SUCCESS[cell.task]
    evaluations = np.where(good.any(axis=1), (good.argmax(axis=1) + 1) * cell.charge, np.nan)
    table = pd.DataFrame(cell.members)
    for name in ("task", "simulator", "method", "knots", "symmetric", "error"):
        table[name] = getattr(cell, name)
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
        evaluations=evaluations,
    )
    for error, tried in zip(cell.tested, np.moveaxis(found.tried, 1, 0), strict=True):
        for quantile in (0.5, 0.9):
            table[f"J {quantile:.0%} at {1000 * error:g} mm"] = np.quantile(tried, quantile, axis=1)
    return table


def run(study: Study, quick: bool, store: Store, piece: Callable) -> pd.DataFrame:
    """The table of all stages, all members. `piece(name, total)` is a context that yields what reports progress."""
    tables: list[pd.DataFrame] = []
    for cell, stage in _cells(study, quick, tables):
        name = f"{cell.task} {cell.simulator}, {cell.method}" + (f", {cell.knots} knots" if cell.knots > 1 else "")
        with piece(name, cell.updates) as report:
            tables.append(rows(cell, store.finish(cell, report), stage))
    return pd.concat(tables, ignore_index=True)


def _cells(study: Study, quick: bool, tables: list[pd.DataFrame]) -> Iterator[tuple[Cell, int]]:
    for stage, cells in enumerate(study.stages):
        known = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
        for cell in cells(quick, known):
            yield cell, stage


def rates(study: Study, table: pd.DataFrame) -> pd.DataFrame:
    """By group, of the last stage: success of the best iterate with its Wilson interval (95 %), of the last; medians."""
    found = []
    last = table[table.stage == table.stage.max()]
    for group, members in last.groupby(list(study.groups), sort=False):
        interval = binomtest(int(members.succeeded.sum()), len(members)).proportion_ci(method="wilson")
        found.append(
            {
                **dict(zip(study.groups, group, strict=True)),
                "members": len(members),
                "success": members.succeeded.mean(),
                "low": interval.low,
                "high": interval.high,
                "success, last": members.succeeded_last.mean(),
                "J best": members.best.median(),
                "J last": members["last"].median(),
                "evaluations": members.evaluations.median(),
                **{name: members[name].median() for name in last.columns if name.startswith("J ") and " at " in name},
            }
        )
    return pd.DataFrame(found).dropna(axis="columns", how="all")
