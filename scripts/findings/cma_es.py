"""Does what is said of CMA-ES hold for another implementation? One cell of `fair_budget` again, with the package cma.

The grasp on `penalty`, the same 100 guesses 3 cm off, population and budget; sigma is tuned as the study tunes it, on
other guesses and by the same rule. Needs `pip install cma`. Prints one row an implementation.
"""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import jax
import numpy as np
import pandas as pd

from tog_mjx.engines import SIMULATORS, precision
from tog_mjx.engines.objective import objective
from tog_mjx.paper.questions.catalogue import candidates, chosen
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.batches import map_points
from tog_mjx.running.console import run_main
from tog_mjx.running.errors import InputError
from tog_mjx.studies.cell import Cell, Found, compute, updates_within
from tog_mjx.studies.study import Comparison, rows

SEEDS, TUNED_ON = range(100), range(1000, 1008)


def main() -> None:
    tables = []
    for package, run in (("evosax", compute), ("cma", with_cma)):
        tuning = cell(TUNED_ON, candidates("grasp", "CMA-ES").sigmas)
        sigmas = chosen(rows(tuning, run(tuning), 0), "grasp", "CMA-ES").sigmas
        reported = cell(SEEDS, sigmas)
        tables.append(rows(reported, run(reported), 1).assign(package=package))
    found = Comparison("", (), ("package", "sigma")).summary(pd.concat(tables))
    print(found.to_string(index=False))


def cell(seeds: range, sigmas: tuple[float, ...]) -> Cell:
    one = Cell("grasp", "penalty", "CMA-ES", 1, tuple(seeds), (0.03,), (0.0,), sigmas)
    return updates_within(get_task("grasp").budget, one)


def with_cma(cell: Cell) -> Found:
    """What `compute` finds, by the package cma: all members side by side, as J is quickest of many points."""
    try:
        import cma
    except ImportError:
        raise InputError("the package cma is not there: pip install cma") from None
    first = compute(updates_within(0, cell)).first
    options = {"popsize": int(cell.charge), "verbose": -9}
    members = [
        cma.CMAEvolutionStrategy(guess, member.sigma, {**options, "seed": member.seed + 1})
        for guess, member in zip(first, cell.members, strict=True)
    ]
    costs, points = [], []
    with precision("penalty"):
        J = jax.vmap(objective("grasp", "penalty"))
        for _ in range(cell.updates):
            asked = np.array([member.ask() for member in members])
            found = map_points(J, asked.reshape(-1, first.shape[1]), chunk=SIMULATORS["penalty"].CHUNK)
            ranked = np.where(np.isfinite(found), found, 1e9).reshape(asked.shape[:2])
            for member, some, values in zip(members, asked, ranked, strict=True):
                member.tell(list(some), list(values))
            costs.append(ranked.min(axis=1))
            points.append(asked[np.arange(len(members)), ranked.argmin(axis=1)])
    best = np.array(points)[np.argmin(costs, axis=0), np.arange(len(members))]
    return Found(np.array(costs).T, first, best, points[-1], np.zeros((len(members), 0, 256)))


if __name__ == "__main__":
    run_main(main)
