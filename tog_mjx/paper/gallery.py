"""All figures of the paper, on the simulators asked for, and Table I."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from tog_mjx.drawing.figures import draw_descents, draw_landscape, draw_motions, draw_setups
from tog_mjx.drawing.figures.descents import FIGURE_NUMBER as DESCENTS
from tog_mjx.drawing.figures.fading import FIGURE_NUMBER as MOTIONS
from tog_mjx.drawing.figures.fading import Motion
from tog_mjx.drawing.figures.landscapes import FIGURE_NUMBER as LANDSCAPES
from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.engines.many import simulate_many
from tog_mjx.paper import captions
from tog_mjx.paper.setups import FIGURE_NUMBER as SETUPS
from tog_mjx.paper.tasks import Task
from tog_mjx.running.storage import atomic_write
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape

EVERY = 5
"""Time steps between two states of the motions drawn."""


class Picture(NamedTuple):
    """A figure on disk: `path` of the PNG (a PDF lies beside it), the paper's number, and what it shows in words."""

    path: Path
    number: int
    caption: str


def draw_common(tasks: Sequence[Task], out: Path) -> list[Picture]:
    """What belongs to no simulator: Figure 1, and Table I as `table_1.md`."""
    with atomic_write(out / "table_1.md") as file:
        file.write(table_1(tasks).encode())
    return [_save(draw_setups(tasks), out, SETUPS, captions.setups())]


def draw_task(
    task: Task, simulator: str, descents: Mapping[str, Descent], landscape: Landscape | None, out: Path
) -> list[Picture]:
    """The figures of one task on one simulator, in the paper's order; without a landscape, those that need none."""
    folder, name = out / simulator, task.name
    pictures = []
    if landscape is not None:
        figure = draw_landscape(task, simulator, landscape, descents)
        pictures.append(_save(figure, folder, LANDSCAPES[name], captions.landscape(task, simulator)))
    figure = draw_descents(name, simulator, descents)
    pictures.append(_save(figure, folder, DESCENTS[name], captions.descents(task, simulator)))
    figure = draw_motions(task, simulator, best_motions(task, simulator, descents))
    pictures.append(_save(figure, folder, MOTIONS[name], captions.motions(task, simulator)))
    return pictures


def best_motions(task: Task, simulator: str, descents: Mapping[str, Descent]) -> dict[str, Motion]:
    """The motions under the initial guess and under the best setpoints of each method, by title."""
    setpoints = {"initial guess": task.initial_guess}
    setpoints |= {f"{method}, best": descent.setpoints_best for method, descent in descents.items()}
    points = np.array(list(setpoints.values()))
    motions = simulate_many(task, simulator, points, EVERY)
    return {
        title: Motion(motions.box[i], motions.fingers[i], points[i], float(motions.costs[i]))
        for i, title in enumerate(setpoints)
    }


def table_1(tasks: Sequence[Task]) -> str:
    """Table I of the paper, the settings of both descents, in Markdown."""
    rows = ["| setting | " + " | ".join(f"box {task.name}" for task in tasks) + " |", "| --- |" + " --- |" * len(tasks)]

    def row(name: str, *values: str) -> None:
        rows.append(f"| {name} | " + " | ".join(values) + " |")

    row("initial guess u (m)", *(", ".join(f"{x:g}" for x in task.initial_guess) for task in tasks))
    row("step, exact: alpha_1", *(f"{task.exact.step_size:g}" for task in tasks))
    row("iterations, exact", *(f"{task.exact.iterations}" for task in tasks))
    row("step, stochastic: alpha_2", *(f"{task.stochastic.step_size:g}" for task in tasks))
    row("sigma (m)", *(f"{task.stochastic.sigma:g}" for task in tasks))
    row("iterations, stochastic", *(f"{task.stochastic.iterations}" for task in tasks))
    row("horizon (time steps)", *(f"{task.steps}" for task in tasks))
    row("time step (s)", *(f"{task.scene.model.opt.timestep:g}" for task in tasks))
    return "\n".join(rows) + "\n"


def _save(figure: Figure, folder: Path, number: int, caption: str) -> Picture:
    path = folder / f"figure_{number}.png"
    save_figure(figure, path, [".pdf"])
    return Picture(path, number, caption)
