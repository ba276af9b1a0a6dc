"""Carries out what is not finished yet, saying how far it is."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from tog_mjx.paper import comparison
from tog_mjx.paper.comparison import Run
from tog_mjx.paper.tasks import get_task
from tog_mjx.running.errors import InputError
from tog_mjx.running.progress import Work
from tog_mjx.running.storage import DamagedFileError
from tog_mjx.studies.landscape import Landscape, landscape


def finish_runs(runs: Sequence[Run], out: Path, console: Console, force: bool = False) -> None:
    """Computes those runs that are not in `out`, or all of them.

    Raises:
      InputError: if `out` has a result of other settings in the place of a run, and not `force`.
    """
    finished = [] if force else find_finished(runs, out, console)
    for i, run in enumerate(runs, 1):
        position = f"[{i}/{len(runs)}] {label(run)}"
        if run in finished:
            console.print(f"{position}: finished before, kept", markup=False)
        else:
            _execute(run, position, out, console)


def find_finished(runs: Sequence[Run], out: Path, console: Console, strict: bool = True) -> list[Run]:
    """The runs whose results are there.

    A damaged result is told and left out. One of other settings is refused if `strict`, else told and left out.
    """
    finished = []
    for run in runs:
        try:
            comparison.load(run, out)
            finished.append(run)
        except FileNotFoundError:
            continue
        except DamagedFileError as error:
            what = "computing it again" if strict else "left out"
            console.print(f"damaged result, {what}: {error}", style="yellow", markup=False)
        except InputError as error:
            if strict:
                raise
            console.print(f"left out: {error}", style="yellow", markup=False)
    return finished


def finish_landscape(simulator: str, task: str, size: int, out: Path, console: Console) -> Landscape:
    """The landscape that `out` keeps, completed or computed."""
    with Work(console).piece(
        f"{simulator} {task} landscape, {size} x {size}", size**2, "reading or compiling"
    ) as report:
        of = get_task(task)
        return landscape(of, simulator, of.plane, size, out / simulator / task, report)


def label(run: Run) -> str:
    """A run in words."""
    return f"{run.simulator} {run.task} {run.method}"


def _execute(run: Run, name: str, out: Path, console: Console) -> None:
    """Computes a run and keeps its result."""
    with Work(console).piece(name, run.rule.iterations + 1) as report:
        descent = comparison.compute(run, report)
    comparison.save(run, descent, out)
    console.print(
        f"{name}: {descent.status.value}, J {descent.costs[0]:.4f} -> {descent.costs[-1]:.4f}, "
        f"best {descent.costs.min():.4f}; compiled in {descent.seconds_compile:.1f} s, ran {descent.seconds_run:.1f} s",
        markup=False,
    )
