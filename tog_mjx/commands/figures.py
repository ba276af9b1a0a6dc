"""Draws the paper's Figures 1 to 7 and its Table I, on every simulator asked for, as PNG and PDF.

Descents and landscapes that the folder keeps are read, the others are computed first: the folder is that of
tog reproduce.
"""

from pathlib import Path

from rich.console import Console

from tog_mjx.engines import SIMULATORS
from tog_mjx.paper import comparison, gallery
from tog_mjx.paper.comparison import METHODS
from tog_mjx.paper.execution import finish_landscape, finish_runs
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.running.console import CONTINUES, GRID_MOST, SEEDS, ArgumentParser, run_main, within
from tog_mjx.running.errors import MANY
from tog_mjx.running.storage import check_writable


def main() -> None:
    args = parse_arguments()
    console = Console(soft_wrap=True, highlight=False)
    tasks = list(TASKS) if args.task == "all" else [args.task]
    runs = comparison.all_runs(args.simulator, tasks, list(METHODS), args.seed, args.iterations)
    check_writable(args.out / "table_1.md")
    finish_runs(runs, args.out, console)
    pictures = gallery.draw_common([get_task(name) for name in tasks], args.out)
    kept = comparison.load_all(runs, args.out)
    for simulator, task in dict.fromkeys((run.simulator, run.task) for run in runs):
        landscape = finish_landscape(simulator, task, args.size, args.out, console)
        descents = {r.method: kept[r] for r in runs if (r.simulator, r.task) == (simulator, task)}
        pictures += gallery.draw_task(get_task(task), simulator, descents, landscape, args.out)
    console.print(f"Table I is in {args.out / 'table_1.md'}; beside each figure lies a PDF:", markup=False)
    for picture in pictures:
        console.print(f"  {picture.image}", markup=False)


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=[*TASKS, "all"], default="all")
    parser.add_argument(
        "--engine", "--simulator", dest="simulator", choices=list(SIMULATORS), nargs="+", default=list(SIMULATORS)
    )
    parser.add_argument(
        "--size",
        type=within(int, 2, GRID_MOST),
        default=200,
        metavar="N",
        help="of a landscape: N x N points; default: 200",
    )
    parser.add_argument(
        "--seed", type=within(int, 0, SEEDS), default=0, metavar="N", help="of the stochastic method (published: 0)"
    )
    parser.add_argument(
        "--iterations", type=within(int, 0, MANY), metavar="N", help="instead of the numbers of Table I"
    )
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR", help="default: results")
    return parser.parse_args()


def run() -> None:
    run_main(main, CONTINUES)
