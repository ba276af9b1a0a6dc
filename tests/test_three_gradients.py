"""Descents along the gradient with the jumps: they follow it, and what it changes in the paper's tale."""

import dataclasses
import itertools

import jax
import numpy as np
import pandas as pd

from tog_mjx.engines.objective import objective
from tog_mjx.paper.questions import catalogue
from tog_mjx.paper.tasks import get_task
from tog_mjx.solving.methods import METHODS
from tog_mjx.studies.cell import Cell, compute


def test_a_method_with_the_jumps_follows_their_gradient():
    cell = Cell("flip", "penalty", "saltation, plain", 4, noises=(0.01,), steps=(0.1,), tested=(0.0,))
    found = compute(cell)
    cost = objective("flip", "penalty", differentiation="saltation")
    iterates, gradient = [found.first[0]], jax.jit(jax.grad(cost))
    for _ in range(3):
        iterates.append(iterates[-1] - 0.1 * gradient(iterates[-1]))
    np.testing.assert_allclose(found.costs[0], [cost(u) for u in iterates], rtol=1e-9)
    np.testing.assert_allclose(found.last[0], iterates[-1], rtol=1e-9)
    np.testing.assert_allclose(found.tried[0, 0], found.costs.min(), rtol=1e-9)


def test_the_papers_grasp_is_the_work_of_a_gradient_that_does_not_see_the_jumps():
    """Table I from the paper's guess: one lifts the box at iteration 47, the other turns round."""
    task, found = get_task("grasp"), {}
    for method in ("exact, plain", "saltation, plain"):
        found[method] = compute(Cell("grasp", "penalty", method, 60, steps=(task.exact.step_size,))).costs[0]
    np.testing.assert_allclose(found["saltation, plain"][:40], found["exact, plain"][:40], atol=1e-3)
    assert found["exact, plain"][47] < 0.4
    assert found["exact, plain"].min() < 0.05
    assert found["saltation, plain"].min() > 0.56


def test_twins_differ_in_their_gradient_alone():
    settings = [("flip", "grasp"), METHODS, (0,), (0.1,), (0.03,), (True,), (0.1,)]
    columns = ["task", "method", "stage", "step", "sigma", "succeeded", "best"]
    known = pd.DataFrame(itertools.product(*settings), columns=columns)
    cells = [cell for cell in catalogue.three_gradients(False, known) if cell.simulator == "penalty"]
    assert {method for twins in catalogue.TWINS for method in twins} < {cell.method for cell in cells}
    for twins in catalogue.TWINS:
        exact, saltation = ([cell for cell in cells if cell.method == method] for method in twins)
        for one, other in zip(exact, saltation, strict=True):
            assert dataclasses.replace(one, method="", updates=0) == dataclasses.replace(other, method="", updates=0)
            spent = one.updates * one.charge, other.updates * other.charge
            given = get_task(one.task).budget * (8 if one.error else 1)  # The average of eight draws.
            assert one.updates == other.updates or max(spent) <= given < min(spent) + other.charge
