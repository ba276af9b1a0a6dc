"""Figures 2 to 7: of each task the landscape, the descents, and the best motions; and what else is drawn of a task."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.descents import draw_descents
from tog_mjx.drawing.figures.fading import Shown, draw_motions
from tog_mjx.drawing.figures.gradient_fields import draw_agreement
from tog_mjx.drawing.figures.landscapes import draw_landscape
from tog_mjx.engines.many import Motions, simulate_many
from tog_mjx.paper.published import published
from tog_mjx.paper.replay import positions
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import GradientField, Landscape

NUMBERS = {"flip": (2, 3, 4), "grasp": (5, 6, 7)}
"""The paper's, of a task's landscape, descents and motions."""
LEVELS = {"flip": np.linspace(0, 3.2, 17), "grasp": np.linspace(0, 1.5, 16)}
"""Of cost, the same for every simulator."""
EVERY = 5
"""Time steps between two states of the motions drawn."""
Descents = Mapping[str, Descent]
"""By method, "exact" and "stochastic" or one of them."""


def landscape_figure(task: Task, simulator: str, landscape: Landscape, descents: Descents) -> Figure:
    """Figure 2 (flip) or 5 (grasp), and beyond it the paths of the first finger's setpoint."""
    paths = {method: (descent.setpoints, descent.costs) for method, descent in descents.items()}
    title = _title(task, simulator)
    return draw_landscape(landscape, LEVELS[task.name], paths, _guess(task), title=title, **_words(task))


def descents_figure(task: Task, simulator: str, descents: Descents) -> Figure:
    """Figure 3 (flip) or 6 (grasp). The flip's last iterates, near zero, are shown larger, and the grasp's first
    hundred, in which exact descent lifts."""
    costs = {method: descent.costs for method, descent in descents.items()}
    last = max(map(len, costs.values())) - 1
    inset = ((last * 0.2, last * 1.03), (0, 0.3))
    if task.name == "grasp":
        inset = ((-1, min(100, last) + 1), (0, 1.05 * min(1.0, max(float(np.max(some)) for some in costs.values()))))
    known = {method: published(task.name, method).costs for method in costs}
    return draw_descents(costs, known, title=_title(task, simulator), cost=_cost(task), inset=inset)


def motions_figure(task: Task, simulator: str, setpoints: Mapping[str, np.ndarray], motions: Motions) -> Figure:
    """Figure 4 (flip) or 7 (grasp): the motions under setpoints, by title."""
    shown = {
        f"{title}: J = {motions.costs[i]:.4f}": Shown(
            positions(task.scene, motions.box[i], motions.fingers[i]),
            motions.fingers[i, ..., :2],
            np.reshape(setpoints[title], (-1, 2)),
        )
        for i, title in enumerate(setpoints)
    }
    margin = 0.12 + np.linalg.norm(task.scene.physics.box_half)
    boxes = motions.box[..., :2].reshape(-1, 2)
    points = np.concatenate([some.reshape(-1, 2) for one in shown.values() for some in one[1:]])
    low = np.minimum(boxes.min(0) - margin, points.min(0) - 0.12)
    high = np.maximum(boxes.max(0) + margin, points.max(0) + 0.12)
    window = ((low[0], high[0]), (-0.12, high[1]))
    names = ("path of a finger", "setpoint")
    return draw_motions(task.scene.model, shown, window, title=_title(task, simulator), names=names)


def best_motions(task: Task, simulator: str, descents: Descents) -> tuple[dict[str, np.ndarray], Motions]:
    """The initial guess and the best setpoints of each method, by title, and the motions under them."""
    setpoints = {"initial guess": task.initial_guess}
    setpoints |= {f"{method}, best": descent.best for method, descent in descents.items()}
    return setpoints, simulate_many(task, simulator, np.array(list(setpoints.values())), EVERY)


def agreement_figure(
    task: Task, fields: Mapping[str, tuple[Landscape, GradientField]], degrees: Float[np.ndarray, " N"]
) -> Figure:
    """`draw_agreement` of two simulators on a task."""
    return draw_agreement(fields, degrees, _guess(task), **_words(task))


def _title(task: Task, simulator: str) -> str:
    return f"Box {task.name} on {simulator}"


def _guess(task: Task) -> np.ndarray:
    """That of the first finger."""
    return task.initial_guess[:2]


def _cost(task: Task) -> str:
    return rf"cost $J_\mathrm{{{task.name}}}$"


def _words(task: Task) -> dict:
    """Of a landscape."""
    finger = "" if len(task.scene.fingers) == 1 else " of the left finger"
    return {"cost": _cost(task), "names": (f"setpoint x{finger} (m)", f"setpoint z{finger} (m)")}
