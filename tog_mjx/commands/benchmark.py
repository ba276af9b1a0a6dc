"""What simulation and its gradients cost on this machine: rivals measured in turns, in one run.

Medians. Compilation is measured apart, without the cache. With --out, the numbers as JSON and a figure beside them.
"""

import contextlib
import platform
from pathlib import Path
from typing import Any

import jax
from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx.drawing.figures.crossover import draw_crossover
from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.mjcf.scene import scene_path
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.running.console import ArgumentParser, run_main
from tog_mjx.running.devices import cores
from tog_mjx.running.storage import check_writable, save_json
from tog_mjx.studies.benchmarks import models, sections

SECTIONS = ("single", "start", "batches", "crossover", "scaling", "engines")
BATCHES, KNOTS, FACTORS = (64, 256, 1024, 4096, 16384, 40000), (1, 4, 16, 64, 256, 512), (1, 4, 16, 64)
QUICK_BATCHES, QUICK_KNOTS, QUICK_FACTORS = (64, 1024), (1, 8), (1, 4)


def main() -> None:
    args = parse_arguments()
    if args.out:
        check_writable(args.out)
    console = Console(width=120, highlight=False)
    jax.config.update("jax_enable_compilation_cache", False)  # Compilation is measured too.
    with jax.enable_x64(not args.float32):
        rows = {name: measure(name, args, console) for name in args.section}
    if args.out:
        save_json(args.out, {"machine": machine(args), **rows})
        if "crossover" in rows:
            save_figure(draw_crossover(rows["crossover"]), args.out.with_suffix(".png"))


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=list(TASKS), default="flip")
    parser.add_argument("--section", choices=SECTIONS, nargs="+", default=list(SECTIONS))
    parser.add_argument(
        "--models",
        type=Path,
        nargs="+",
        default=[scene_path(name) for name in TASKS],
        metavar="FILE",
        help="MJCF files with actuators, of the section engines (default: the scenes of both tasks)",
    )
    parser.add_argument("--quick", action="store_true", help="fewer rounds, smaller batches, fewer knots")
    parser.add_argument(
        "--repeats", type=int, metavar="N", help="rounds, of which the median is taken (default: 15; quick: 3)"
    )
    parser.add_argument(
        "--batch", type=int, nargs="+", metavar="N", help=f"sizes of batches (default: {', '.join(map(str, BATCHES))})"
    )
    parser.add_argument("--float32", action="store_true", help="instead of float64")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="where to keep the numbers")
    args = parser.parse_args()
    if args.repeats is None:
        args.repeats = 3 if args.quick else 15
    if args.batch is None:
        args.batch = QUICK_BATCHES if args.quick else BATCHES
    for option, value in (("--repeats", args.repeats), ("--batch", min(args.batch))):
        if value < 1:
            parser.error(f"argument {option}: {value} is too few; give 1 or more")
    return args


def measure(name: str, args, console: Console) -> list[dict[str, Any]]:
    """Runs a section and prints its table."""
    task, few = get_task(args.task), max(1, args.repeats // 5)
    with console.status(name) if console.is_terminal else contextlib.nullcontext() as status:

        def report(text: str) -> None:
            if status is not None:
                status.update(text)
            else:
                console.print(text, style="dim")

        match name:
            case "single":
                rows = sections.single(task, args.repeats, report)
            case "start":
                rows = sections.start(task, report)
            case "batches":
                rows = sections.batches(task, args.batch, few, report)
            case "crossover":
                knots = QUICK_KNOTS if args.quick else KNOTS
                rows = sections.crossover(task, knots, few, report)
            case "engines":
                rows = models.engines(args.models, few, report)
            case _:
                rows = sections.scaling(task, QUICK_FACTORS if args.quick else FACTORS, few, report)
    console.print(table(f"{name}, {args.task}, {'float32' if args.float32 else 'float64'}", rows))
    return rows


def table(title: str, rows: list[dict[str, Any]]) -> Table:
    """Rows as they are, numbers to three digits."""
    found = Table(title=title, title_justify="left", box=box.MARKDOWN)
    for column, value in rows[0].items():
        found.add_column(column, justify="left" if isinstance(value, str) else "right", no_wrap=True)
    for row in rows:
        found.add_row(*(f"{v:.3g}" if isinstance(v, float) else "-" if v is None else str(v) for v in row.values()))
    return found


def machine(args) -> dict[str, Any]:
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": cores(),
        "devices": [str(device) for device in jax.devices()],
        "jax": jax.__version__,
        "precision": "float32" if args.float32 else "float64",
        "repeats": args.repeats,
    }


def run() -> None:
    run_main(main)
