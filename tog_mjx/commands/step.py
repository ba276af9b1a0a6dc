"""Is the derivative of one step right? Any MJCF scene, by tog.step and by stock MJX, against differences.

The state is that of the scene's first keyframe, or its initial pose. The derivative is in state, controls and every
parameter of the model. Prints a table in Markdown.
"""

import jax
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tog_mjx.checks.step_check import METHODS, ORDERS, Verdict, check_second_order, check_step, require_joints
from tog_mjx.mjcf.scene import load_scene
from tog_mjx.running.console import ArgumentParser, run_main
from tog_mjx.running.errors import printable
from tog_mjx.running.progress import Work

WIDTH = 140


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="+", help="an MJCF file, or flip or grasp")
    parser.add_argument(
        "--second-order", action="store_true", help="errors of the Hessian of tog.step in state and controls instead"
    )
    args = parser.parse_args()
    scenes = {name: load_scene(name) for name in args.scene}
    for name, scene in scenes.items():
        require_joints(scene.model, name)
    progress, table = Work(Console(stderr=True)), Table(box=box.MARKDOWN)
    for column in ("scene", *(ORDERS if args.second_order else METHODS)):
        table.add_column(column, no_wrap=True)
    not_finite: set[str] = set()
    kinks: dict[str, tuple[str, ...]] = {}
    with jax.enable_x64():
        for i, scene in enumerate(scenes.values(), 1):
            name = printable(scene.name)
            if args.second_order:
                with progress.piece(f"[{i}/{len(scenes)}] {name}", 1):
                    errors = check_second_order(scene.model)
                table.add_row(escape(name), *(f"{error:.0e}" for error in errors.values()))
                continue
            with progress.piece(f"[{i}/{len(scenes)}] {name}", len(METHODS)) as report:
                verdicts = check_step(scene.model, report=report)
            table.add_row(escape(name), *map(told, verdicts.values()))
            kinks[name] = next((verdict.kinks for verdict in verdicts.values() if verdict.kinks), ())
            not_finite |= {name for verdict in verdicts.values() for name in verdict.nan}
    Console(width=WIDTH, highlight=False).print(table)
    if not_finite:
        print(f"* but NaN in parameters: {', '.join(sorted(not_finite))}")
    for name, numbers in kinks.items():
        if numbers:
            print(f"{name}: its state is at a kink, so that there is nothing to compare with, in {', '.join(numbers)}")


def told(verdict: Verdict) -> str:
    error = "" if verdict.error is None else f" {verdict.error:.0e}"
    return f"{verdict.word}{error}{' *' if verdict.nan else ''}"


def run() -> None:
    run_main(main)
