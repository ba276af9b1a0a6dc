"""The file of a run of three iterates, made up: the best one is number 1."""

from pathlib import Path

import numpy as np

from tog_mjx.paper import comparison
from tog_mjx.paper.comparison import Run
from tog_mjx.solving.descent import Descent, Status

COSTS = np.array([2.0, 1.0, 1.5])


def save_run(folder: Path, setpoints: np.ndarray, simulator: str = "penalty", task: str = "flip") -> Path:
    """Saves a run with these setpoints [3, n] in a folder, and returns its path."""
    record = Descent(COSTS, setpoints, np.zeros_like(setpoints), Status.EXHAUSTED, 0.0, 0.0)
    run = Run(simulator, task, "exact", iterations=2)
    comparison.save(run, record, folder)
    return run.path(folder)
