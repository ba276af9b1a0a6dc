"""The interactive part of the report: what it plays, simulated here."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tog_mjx.drawing.report.packed import FARTHEST, QUANTUM, pack, picture
from tog_mjx.engines.many import simulate_many
from tog_mjx.paper.outcomes import LEVELS
from tog_mjx.paper.replay import poses
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape

GRID, ITERATES, EVERY = 33, 2001, 10
"""Points of the window along each axis, iterates of a descent at most, time steps from one pose to the next."""


def scenario(
    task: Task,
    simulator: str,
    landscape: Landscape,
    descents: Mapping[str, Descent],
    report: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """All that the page needs to show a task on a simulator, as JSON: see `page.js` for its use."""
    points = task.plane.grid(GRID)
    chosen = {method: thinned(len(descent.costs)) for method, descent in descents.items()}
    setpoints = [np.asarray(task.plane.x(points))]
    setpoints += [descents[method].setpoints[kept] for method, kept in chosen.items()]
    motions = simulate_many(task, simulator, np.concatenate(setpoints), EVERY, report)
    first, paths = len(points), {}
    for method, kept in chosen.items():
        paths[method] = {"first": first, "iterations": kept.tolist(), "best": descents[method].best_iteration}
        first += len(kept)
    physics = task.scene.physics
    return {
        "task": task.name,
        "simulator": simulator,
        "window": task.window,
        "grid": GRID,
        "landscape": picture(landscape.costs, LEVELS[task.name][-1]),
        "setpoints": np.concatenate(setpoints).round(4).tolist(),
        "costs": [float(cost) if np.isfinite(cost) else None for cost in motions.costs],
        "paths": paths,
        "seconds": motions.time.round(6).tolist(),
        "quantum": QUANTUM,
        "motions": pack(poses(motions.box, motions.fingers)),
        "view": _view(task, [descent.best for descent in descents.values()]),
        "half": physics.box_half.tolist(),
        "radius": physics.finger_radius,
    }


def thinned(number: int) -> Int[np.ndarray, " k"]:
    """Of iterates 0 to number - 1, at most `ITERATES`, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, number - 1, min(number, ITERATES)).round().astype(int))


def _view(task: Task, best: Sequence[Float[np.ndarray, " n"]]) -> list[float]:
    """x_min, x_max, z_min, z_max of the view: start and goal, the landscape's setpoints, and the best ones."""
    box, fingers = task.scene.start
    margin = 0.1 + float(np.linalg.norm(task.scene.physics.box_half))
    setpoints = np.concatenate([np.reshape(u, (-1, 2)) for u in best])
    (x_min, x_max), (_, z_max) = task.window
    x = [box[0] - margin, box[0] + margin, task.goal[0] - margin, task.goal[0] + margin, x_min - 0.1, x_max + 0.1]
    x += [*(fingers[:, 0] - 0.1), *(setpoints[:, 0] - 0.1), *(setpoints[:, 0] + 0.1)]
    z = [z_max + 0.1, task.goal[1] + margin, *(setpoints[:, 1] + 0.1)]
    x, z = np.clip(x, -FARTHEST, FARTHEST), np.clip(z, 0, FARTHEST)
    return [float(x.min()), float(x.max()), -0.1, float(z.max())]
