"""All figures of the paper, on the simulators asked for, and Table I."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.drawing.report import Picture, Table
from tog_mjx.paper import captions, outcomes
from tog_mjx.paper.setups import draw_setups
from tog_mjx.paper.tasks import Task
from tog_mjx.running.storage import atomic_write
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape


def draw_common(tasks: Sequence[Task], out: Path) -> list[Picture]:
    """What belongs to no simulator: Figure 1, and Table I as `table_1.md`."""
    header, *rows = [" | ".join(row) for row in (table_1(tasks).header, *table_1(tasks).rows)]
    lines = [f"| {header} |", "| --- |" + " --- |" * len(tasks), *(f"| {row} |" for row in rows)]
    with atomic_write(out / "table_1.md") as file:
        file.write(("\n".join(lines) + "\n").encode())
    return [_save(draw_setups(tasks), out, 1, captions.setups())]


def draw_task(
    task: Task, simulator: str, descents: Mapping[str, Descent], landscape: Landscape | None, out: Path
) -> list[Picture]:
    """The figures of one task on one simulator, in the paper's order; without a landscape, those that need none."""
    folder, numbers = out / simulator, outcomes.NUMBERS[task.name]
    pictures = []
    if landscape is not None:
        figure = outcomes.landscape_figure(task, simulator, landscape, descents)
        pictures.append(_save(figure, folder, numbers[0], captions.landscape(task, simulator)))
    figure = outcomes.descents_figure(task, simulator, descents)
    pictures.append(_save(figure, folder, numbers[1], captions.descents(task, simulator)))
    figure = outcomes.motions_figure(task, simulator, *outcomes.best_motions(task, simulator, descents))
    pictures.append(_save(figure, folder, numbers[2], captions.motions(task, simulator)))
    return pictures


def table_1(tasks: Sequence[Task]) -> Table:
    """Table I of the paper, the settings of both descents."""

    def row(name: str, value: Callable[[Task], str]) -> list[str]:
        return [name, *map(value, tasks)]

    rows = [
        row("initial guess u (m)", lambda task: ", ".join(f"{x:g}" for x in task.initial_guess)),
        row("step, exact: alpha_1", lambda task: f"{task.exact.step_size:g}"),
        row("iterations, exact", lambda task: f"{task.exact.iterations}"),
        row("step, stochastic: alpha_2", lambda task: f"{task.stochastic.step_size:g}"),
        row("sigma (m)", lambda task: f"{task.stochastic.sigma:g}"),
        row("iterations, stochastic", lambda task: f"{task.stochastic.iterations}"),
        row("horizon (time steps)", lambda task: f"{task.steps}"),
        row("time step (s)", lambda task: f"{task.scene.model.opt.timestep:g}"),
    ]
    return Table(row("setting", lambda task: f"box {task.name}"), rows)


def _save(figure: Figure, folder: Path, number: int, caption: str) -> Picture:
    """A PNG, and a PDF beside it."""
    path = folder / f"figure_{number}.png"
    save_figure(figure, path, [".pdf"])
    return Picture(path, f"Figure {number}", caption)
