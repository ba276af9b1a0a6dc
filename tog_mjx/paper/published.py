"""The numbers that the paper's released program published, to hold a run against.

Traces of cost over iterations, the initial guess first. Of the stochastic grasp, 1000 iterations long, only the first,
last and least cost are kept.
"""

import functools
import json
from importlib import resources
from typing import NamedTuple

import numpy as np


class Published(NamedTuple):
    """One published descent. `costs` [k + 1] is empty where only the summary was kept.

    `setpoints` [m, 2F] are those of the iterations `setpoints_at` [m].
    """

    iterations: int
    cost_first: float
    cost_last: float
    cost_best: float
    costs: np.ndarray
    setpoints: np.ndarray
    setpoints_at: np.ndarray


@functools.cache
def published(task: str, method: str) -> Published:
    """The published run of a task ("flip", "grasp") by a method ("exact", "stochastic")."""
    traces = json.loads(resources.files(__package__).joinpath("published_traces.json").read_text())
    trace = traces[f"{task}_{method}"]
    if "cost" in trace:
        costs = np.array(trace["cost"])
        setpoints = np.array(trace.get("setpoints", []))
        at = np.array(trace.get("setpoints_at_iteration", range(len(setpoints))), int)
        return Published(len(costs) - 1, costs[0], costs[-1], costs.min(), costs, setpoints, at)
    none = np.array([])
    return Published(trace["iterations"], trace["cost_first"], trace["cost_last"], trace["cost_min"], none, none, none)
