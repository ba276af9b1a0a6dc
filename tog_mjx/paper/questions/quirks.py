"""The study of the released program's quirks: with one of them mended, do Table I's methods fare as the paper says?

Exact descent starts from the paper's guess; from guesses beside it, since one run that fails may be no more than bad
luck; and, in the grasp, from mirror-symmetric guesses beside it, since the released descent never leaves that symmetry.
"""

import dataclasses
import itertools

import pandas as pd

from tog_mjx.paper.released import MENDED
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.studies.cell import Cell
from tog_mjx.studies.study import Comparison

NOISE = 1e-3
"""Standard deviation of the guesses beside the paper's, in m."""
QUICK = ("nothing", "contact damping")


def mended(quick: bool, known: pd.DataFrame) -> list[Cell]:
    """Table I with each quirk mended alone."""
    del known
    cells = []
    for name, quirk in itertools.product(TASKS, QUICK if quick else MENDED):
        task = get_task(name)
        near, many = range(4 if quick else 16), range(4 if quick else 32)
        for method, rule, seeds, noise, symmetric in (
            ("exact, plain", task.exact, range(1), 0.0, False),
            ("exact, plain", task.exact, near, NOISE, False),
            ("exact, plain", task.exact, near, NOISE, True),
            ("stochastic, plain", task.stochastic, many, 0.0, False),
        ):
            updates = 1 + (min(rule.iterations, 100) if quick else rule.iterations)
            some, steps, sigmas, options = tuple(seeds), (rule.step_size,), (rule.sigma,), (("mended", quirk),)
            if name == "grasp" or not symmetric:
                cell = Cell(name, "released", method, updates, some, (noise,), steps, sigmas, 1, symmetric)
                cells.append(dataclasses.replace(cell, options=options))
    return cells


released_quirks = Comparison(
    "Does what the paper concludes depend on a quirk of its program?",
    (mended,),
    ("task", "method", "mended", "symmetric", "noise"),
)
