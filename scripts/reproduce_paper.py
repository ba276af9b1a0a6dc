"""The paper's controlled comparison, from one command: exact against stochastic gradient descent through contact.

Runs every simulator, task and method asked for with the settings of the paper's Table I, keeps each result in its own
file, and prints this run beside the published numbers. A finished run is read, not repeated.
"""

from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx import comparison
from tog_mjx.comparison import METHODS, Run
from tog_mjx.console import ArgumentParser, Work, check_writable, run_main
from tog_mjx.descent import Descent
from tog_mjx.errors import InputError
from tog_mjx.figures import draw_descents
from tog_mjx.figures.descents import FIGURE_NUMBER
from tog_mjx.figures.style import save_figure
from tog_mjx.published import published
from tog_mjx.simulators import SIMULATORS
from tog_mjx.storage import DamagedFileError, save_json
from tog_mjx.tasks import TASKS


def main() -> None:
    args = parse_arguments()
    console = Console(soft_wrap=True, highlight=False)
    tasks = list(TASKS) if args.task == "all" else [args.task]
    runs = comparison.all_runs(args.simulator, tasks, args.method, args.seed, args.iterations)
    check_writable(args.out)

    finished = [] if args.force else find_finished(runs, args.out, console)
    for i, run in enumerate(runs, 1):
        position = f"[{i}/{len(runs)}] {label(run)}"
        if run in finished:
            console.print(f"{position}: finished before, kept", markup=False)
        else:
            execute(run, position, args.out, console)

    # Runs of the same settings that were not asked for this time belong to the picture too.
    everything = comparison.all_runs(list(SIMULATORS), list(TASKS), list(METHODS), args.seed, args.iterations)
    descents = {
        run: comparison.load(run, args.out) for run in find_finished(everything, args.out, console, strict=False)
    }
    save_json(args.out / "summary.json", [comparison.summarise(run, descent) for run, descent in descents.items()])
    figures = draw_figures(descents, args.out)
    console.print(closing_table(descents))
    for run, deviation in deviations(descents).items():
        console.print(f"{label(run)}: largest difference from the published trace {deviation:.1e}")
    written = ", ".join(map(str, figures))
    console.print(f"Results and summary.json are in {args.out}; figures: {written}", markup=False)


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=[*TASKS, "all"], default="all")
    parser.add_argument("--simulator", choices=list(SIMULATORS), nargs="+", default=list(SIMULATORS))
    parser.add_argument("--method", choices=METHODS, nargs="+", default=list(METHODS))
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the stochastic method (published: 0)")
    parser.add_argument("--iterations", type=int, metavar="N", help="instead of the numbers of Table I")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR", help="default: results")
    parser.add_argument("--force", action="store_true", help="repeat finished runs and replace their results")
    args = parser.parse_args()
    for option in ("seed", "iterations"):
        if (getattr(args, option) or 0) < 0:
            parser.error(f"argument --{option}: {getattr(args, option)} is negative; give 0 or more")
    return args


def find_finished(runs: list[Run], out: Path, console: Console, strict: bool = True) -> list[Run]:
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


def execute(run: Run, name: str, out: Path, console: Console) -> None:
    """Computes a run and keeps its result."""
    with Work(console).piece(name, run.rule.iterations + 1) as report:
        descent = comparison.compute(run, report)
    comparison.save(run, descent, out)
    console.print(
        f"{name}: {descent.status.value}, J {descent.costs[0]:.4f} -> {descent.costs[-1]:.4f}, "
        f"best {descent.costs.min():.4f}; compiled in {descent.seconds_compile:.1f} s, ran {descent.seconds_run:.1f} s",
        markup=False,
    )


def draw_figures(descents: dict[Run, Descent], out: Path) -> list[Path]:
    paths = []
    for simulator, task in dict.fromkeys((run.simulator, run.task) for run in descents):
        chosen = {run.method: d for run, d in descents.items() if (run.simulator, run.task) == (simulator, task)}
        path = out / simulator / f"figure_{FIGURE_NUMBER[task]}.png"
        save_figure(draw_descents(task, simulator, chosen), path)
        paths.append(path)
    return paths


def closing_table(descents: dict[Run, Descent]) -> Table:
    """This run beside the published numbers, grouped by task and method."""
    table = Table(title="Cost J, this run beside the published numbers", box=box.SIMPLE, title_justify="left")
    for column in ("descent", "simulator"):
        table.add_column(column, no_wrap=True)
    for column in ("first", "last", "best", "best at"):
        table.add_column(column, justify="right", no_wrap=True)
    for task, method in dict.fromkeys((run.task, run.method) for run in descents):
        known = published(task, method)
        at = f"{known.costs.argmin() if known.costs.size else '?'} of {known.iterations}"
        costs = (f"{c:.4f}" for c in (known.cost_first, known.cost_last, known.cost_best))
        table.add_row(f"{task} {method}", "published", *costs, at, style="italic")
        for run, descent in descents.items():
            if (run.task, run.method) == (task, method):
                costs = (f"{c:.4f}" for c in (descent.costs[0], descent.costs[-1], descent.costs.min()))
                table.add_row("", run.simulator, *costs, f"{descent.best_iteration} of {descent.iterations}")
        table.add_section()
    return table


def deviations(descents: dict[Run, Descent]) -> dict[Run, float]:
    """How far the released program's runs are from their published traces, where its settings are those."""
    found = {}
    for run, descent in descents.items():
        trace = published(run.task, run.method).costs
        if run.simulator == "released" and run.seed == 0 and len(trace) == len(descent.costs):
            found[run] = float(np.abs(descent.costs - trace).max())
    return found


def label(run: Run) -> str:
    return f"{run.simulator} {run.task} {run.method}"


if __name__ == "__main__":
    run_main(main)
