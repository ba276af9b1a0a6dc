"""The paper's controlled comparison, from one command: exact against stochastic gradient descent through contact.

Runs every simulator, task and method asked for with the settings of the paper's Table I, keeps each result in its own
file, prints this run beside the published numbers, draws all figures, and writes report.html, one page that holds
everything. A finished run is read, not repeated.
"""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx.drawing.report import Picture, Section
from tog_mjx.engines import SIMULATORS
from tog_mjx.paper import comparison, gallery
from tog_mjx.paper.answer import write_report
from tog_mjx.paper.comparison import METHODS, Run
from tog_mjx.paper.execution import find_finished, finish_landscape, finish_runs, label
from tog_mjx.paper.published import published
from tog_mjx.paper.scenario import GRID, scenario, thinned
from tog_mjx.paper.tasks import TASKS, Task, get_task
from tog_mjx.running.console import GRID_MOST, SEEDS, ArgumentParser, run_main, within
from tog_mjx.running.errors import MANY
from tog_mjx.running.progress import Work
from tog_mjx.running.storage import check_writable, save_json
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape

REPORT = "report.html"


def main() -> None:
    args = parse_arguments()
    console = Console(soft_wrap=True, highlight=False)
    tasks = list(TASKS) if args.task == "all" else [args.task]
    runs = comparison.all_runs(args.simulator, tasks, args.method, args.seed, args.iterations)
    check_writable(args.out / "summary.json")
    finish_runs(runs, args.out, console, args.force)

    # Runs of the same settings that were not asked for this time belong to the picture too.
    everything = comparison.all_runs(list(SIMULATORS), list(TASKS), list(METHODS), args.seed, args.iterations)
    finished = find_finished(everything, args.out, console, strict=False)
    descents = comparison.load_all([run for run in everything if run in {*finished, *runs}], args.out)
    save_json(args.out / "summary.json", [comparison.summarise(run, descent) for run, descent in descents.items()])
    illustrate(descents, args.landscape, args.out, console)
    console.print(closing_table(descents))
    for run, deviation in deviations(descents).items():
        console.print(f"{label(run)}: largest difference from the published trace {deviation:.1e}")
    console.print(
        f"Results, summary.json and figures are in {args.out}; open {args.out / REPORT} in a browser", markup=False
    )
    if not args.landscape:
        console.print(
            "The same command with --landscape 100 adds cost landscapes, and a motion for each of their points"
        )


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=[*TASKS, "all"], default="all")
    parser.add_argument(
        "--engine", "--simulator", dest="simulator", choices=list(SIMULATORS), nargs="+", default=list(SIMULATORS)
    )
    parser.add_argument("--method", choices=METHODS, nargs="+", default=list(METHODS))
    parser.add_argument(
        "--seed", type=within(int, 0, SEEDS), default=0, metavar="N", help="of the stochastic method (published: 0)"
    )
    parser.add_argument(
        "--iterations", type=within(int, 0, MANY), metavar="N", help="instead of the numbers of Table I"
    )
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR", help="default: results")
    parser.add_argument(
        "--landscape",
        type=within(int, 0, GRID_MOST),
        default=0,
        metavar="N",
        help="cost landscapes of N x N points (the paper: 200), and their motions on the page; default: none",
    )
    parser.add_argument("--force", action="store_true", help="repeat finished runs and replace their results")
    args = parser.parse_args()
    if args.landscape == 1:
        parser.error("argument --landscape: 1 is too small; give 2 or more, or 0 for none")
    return args


def illustrate(descents: dict[Run, Descent], size: int, out: Path, console: Console) -> None:
    """All figures, and the page that holds everything. Without landscapes (size 0), the figures that need none."""
    tasks = [get_task(name) for name in dict.fromkeys(run.task for run in descents)]
    common = Section("The tasks", gallery.draw_common(tasks, out))
    # The quick simulators are computed first; MJX, the last one, is what a reader came for.
    found = [
        illustrate_simulator(simulator, descents, size, out, console)
        for simulator in dict.fromkeys(run.simulator for run in descents)
    ][::-1]
    scenarios = [one for _, played in found for one in played]
    write_report(out / REPORT, descents, [common, *(section for section, _ in found)], scenarios, tasks)


def illustrate_simulator(
    simulator: str, descents: dict[Run, Descent], size: int, out: Path, console: Console
) -> tuple[Section, list[dict[str, Any]]]:
    """The figures of one simulator, and what the page plays of it."""
    pictures: list[Picture] = []
    scenarios = []
    for name in dict.fromkeys(run.task for run in descents if run.simulator == simulator):
        chosen = {run.method: d for run, d in descents.items() if (run.simulator, run.task) == (simulator, name)}
        landscape = finish_landscape(simulator, name, size, out, console) if size else None
        pictures += gallery.draw_task(get_task(name), simulator, chosen, landscape, out)
        if landscape is not None:
            scenarios.append(finish_scenario(get_task(name), simulator, landscape, chosen, console))
    return Section(f"On {simulator}", pictures), scenarios


def finish_scenario(
    task: Task, simulator: str, landscape: Landscape, descents: dict[str, Descent], console: Console
) -> dict[str, Any]:
    """The motions of the page's interactive part, simulated."""
    total = GRID**2 + sum(len(thinned(len(descent.costs))) for descent in descents.values())
    with Work(console).piece(f"{simulator} {task.name} motions", total) as report:
        return scenario(task, simulator, landscape, descents, report)


def closing_table(descents: dict[Run, Descent]) -> Table:
    """This run beside the published numbers, grouped by task and method."""
    table = Table(title="Cost J, this run beside the published numbers", box=box.SIMPLE, title_justify="left")
    for column in ("descent", "simulator"):
        table.add_column(column, no_wrap=True)
    for column in ("first", "last", "best", "best at"):
        table.add_column(column, justify="right", no_wrap=True)
    for (task, method), rows in itertools.groupby(comparison.table_rows(descents), lambda row: (row.task, row.method)):
        for row in rows:
            costs = (f"{cost:.4f}" for cost in row.costs)
            is_first = row.source == "published"
            name = f"{task} {method}" if is_first else ""
            table.add_row(name, row.source, *costs, row.best_at, style="italic" if is_first else None)
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


def run() -> None:
    run_main(main, "what was finished is kept, the same command continues unless it has --force")
