"""Descend on a problem of your own, as my_problem.py:push: what is best, how it moves, and the landscape around it.

An installed package brings one, tog_mjx.examples.push:push. Writes best.npy, descent.npz, figures, a GIF and a page,
index.html. A landscape that was killed goes on where it was.
"""

import argparse
import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from rich.console import Console

from tog_mjx.drawing import viewing
from tog_mjx.drawing.figures import draw_descents, draw_landscape
from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.drawing.report.page import Picture, Section, Table, write_page
from tog_mjx.engines import ENGINES, choose_engine, gradient_charge, objective, precision
from tog_mjx.engines.simulator import AUTO
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.problems import Plane, Problem
from tog_mjx.running.console import GRID_MOST, ArgumentParser, run_main, within
from tog_mjx.running.digests import function_digest, lowered, program_digest
from tog_mjx.running.progress import Work
from tog_mjx.running.storage import DamagedFileError, atomic_write, check_writable
from tog_mjx.solving import solve as solving
from tog_mjx.solving.descent import Descent
from tog_mjx.solving.record import load_descent, save_descent
from tog_mjx.stepping.implicit import STEPS as DIFFERENTIATIONS
from tog_mjx.studies.landscape import gradient_field, landscape

ARROWS = 10
"""Gradients of the landscape, along each axis."""
PIXELS = (640, 360)
"""Of the GIF, which is slowed down where the motion is shorter."""
TOLD = 8
"""Variables on the screen; the page has all, to `MOST`."""
MOST = 100


def main() -> None:
    args = parse_arguments()
    console = Console(soft_wrap=True, highlight=False)
    problem = get_task(args.problem) if args.problem in TASKS else Problem.load(args.problem)
    out = args.out or Path("results") / problem.name
    names = ("best.npy", "descent.npz", "descent.png", "landscape.png", "motion.gif", "index.html")
    check_writable(*(out / name for name in names))
    pair = args.landscape or (0, 1)
    if args.size and (args.landscape or len(problem.x0) > 1):  # Names are checked before the work.
        plane_of(problem, pair, problem.x0[None])
    method = "saltation" if args.differentiation == "saltation" else "exact"

    work = Work(console)
    if args.engine == AUTO:
        args.engine = engine_of(problem, args, out / "descent.npz", work)
        args.budget *= charge_of(args) / gradient_charge(AUTO, args.differentiation)  # As many updates on either.
    descent = descend(problem, args, out / "descent.npz", work)
    with atomic_write(out / "best.npy") as file:
        np.save(file, descent.best)
    lines = told(problem, args.engine, descent)
    console.print("\n".join(lines), markup=False)
    pictures = [descent_picture(problem, descent, method, out)]
    if args.size and len(problem.x0) > 1:
        plane = plane_of(problem, pair, descent.setpoints, descent.best_iteration)
        pictures.append(landscape_picture(problem, args, plane, descent, method, out, work))
    pictures.append(motion_picture(problem, descent.best, args.engine, out))
    sections = [
        Section("What it found", pictures),
        Section("The best variables", table=table_of(problem, descent.best)),
    ]
    subject = f"{args.problem}: {len(problem.x0)} variables, {problem.steps} time steps, on {args.engine}"
    write_page(out / "index.html", problem.name, subject, lines, sections, footer="tog solve")
    console.print(f"best.npy, descent.npz, the figures and index.html are in {out}", markup=False)


def parse_arguments() -> argparse.Namespace:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problem", help=f"file.py:function or package.module:function, or {', '.join(TASKS)}")
    parser.add_argument("--engine", choices=[AUTO, *ENGINES], default=AUTO,
                        help="default: %(default)s, the cheaper one of mjx and mujoco")  # fmt: skip
    parser.add_argument("--budget", type=within(float, 1, 1e9), default=1000, metavar="N",
                        help="evaluations of J; a gradient takes about 4 (default: %(default)s)")  # fmt: skip
    parser.add_argument("--differentiation", choices=list(DIFFERENTIATIONS), help="default: that of the engine")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="default: results/NAME")
    parser.add_argument("--landscape", nargs=2, metavar=("A", "B"),
                        help="variables, by name or number (default: the first two)")  # fmt: skip
    parser.add_argument("--size", type=within(int, 0, GRID_MOST), default=40, metavar="K",
                        help="of the landscape: K x K points (default: %(default)s; 0: none)")  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="read a finished descent of the same problem again")
    args = parser.parse_args()
    if args.size == 1:
        parser.error("argument --size: 1 is too small; give 2 or more, or 0 for no landscape")
    return args


def options_of(args: argparse.Namespace) -> dict[str, Any]:
    return {"differentiation": args.differentiation} if args.differentiation else {}


def charge_of(args: argparse.Namespace) -> float:
    return gradient_charge(args.engine, args.differentiation)


def engine_of(problem: Problem, args: argparse.Namespace, path: Path, work: Work) -> str:
    """That of the descent that is read again, or the cheaper one."""
    if args.resume:
        with contextlib.suppress(FileNotFoundError, DamagedFileError):
            if (kept := str(load_descent(path)[1].get("engine"))) in ENGINES:
                return kept
    gradients = max(1, int(args.budget / gradient_charge(AUTO, args.differentiation)))
    with work.console.status("the cheaper engine") if work.console.is_terminal else contextlib.nullcontext():
        choice = choose_engine(problem, gradients, **options_of(args))
    work.console.print(f"on {choice.engine}: {choice.reason}", markup=False)
    return choice.engine


def descend(problem: Problem, args: argparse.Namespace, path: Path, work: Work) -> Descent:
    """The descent that `path` keeps of this problem, with --resume, or a new one."""
    options = options_of(args)
    with precision(args.engine, **options):
        J = objective(problem, args.engine, **options)
        x, bound = problem.check(problem.x0), problem.bound
        settings: dict[str, Any] = {
            "engine": args.engine,
            "budget": args.budget,
            **options,
            "problem": function_digest(lowered(J, x), np.asarray(x), *problem.limits, bound.scale),
            "program": program_digest(solving.__name__),
        }
        if args.resume:
            with contextlib.suppress(FileNotFoundError, DamagedFileError):
                descent, made_with = load_descent(path)
                if made_with == settings:
                    return descent
                work.console.print(
                    f"{path} is of another problem, or of other settings: descending again", markup=False
                )
        total = max(1, int(args.budget / charge_of(args)))
        with work.piece(f"descent on {problem.name}", total) as report:
            descent = solving.solve(problem, budget=args.budget, engine=args.engine, report=report, **options)
    save_descent(path, descent, settings)
    return descent


def judged_costs(descent: Descent) -> np.ndarray:
    """By which the best iterate is the best; infinite where it was not judged."""
    return descent.costs if descent.held_out is None else np.nan_to_num(descent.held_out, nan=np.inf)


def told(problem: Problem, engine: str, descent: Descent) -> list[str]:
    """What came out, in a few lines."""
    judged = judged_costs(descent)
    first, best = judged[0], judged[descent.best_iteration]
    solved = ""
    if problem.success is not None:
        word = "solved, below" if best < problem.success else "not solved, which is below"
        solved = f": {word} {problem.success:g}"
    ways = zip(problem.bound.names, descent.best, strict=True)
    at = ", ".join(f"{name} = {value:.4g}" for name, value in list(ways)[:TOLD])
    more = f", and {len(problem.x0) - TOLD} more in best.npy" if len(problem.x0) > TOLD else ""
    starts = "" if descent.held_out is None else " on held-out starts"
    return [
        f"J of {problem.name} on {engine}{starts}: {first:.4g} at the guess, {best:.4g} at the best iterate{solved}.",
        f"The best is iterate {descent.best_iteration} of {descent.iterations} ({descent.ended}); "
        f"compiled in {descent.seconds_compile:.1f} s, ran {descent.seconds_run:.1f} s.",
        f"There {at}{more}.",
    ]


def plane_of(problem: Problem, pair: Sequence[str | int], iterates: np.ndarray, best: int = 0) -> Plane:
    """That of two variables through the best of the iterates, wide enough for all of them."""
    first, second = (int(some) if str(some).isdecimal() else some for some in pair)
    plane = Plane.of(problem, first, second, through=iterates[best])
    path = plane.project(iterates)
    low, high = np.minimum(plane.low, path.min(axis=0)), np.maximum(plane.high, path.max(axis=0))
    return dataclasses.replace(plane, low=low, high=high)


def descent_picture(problem: Problem, descent: Descent, method: str, out: Path) -> Picture:
    figure = draw_descents({method: descent.costs}, title=problem.name)
    caption = "Cost of each iterate; the first one is the guess."
    if descent.held_out is not None:
        caption += " Each is the mean over its own draw of starts; held-out ones say which is the best."
    if problem.success is not None:
        figure.axes[0].axhline(problem.success, color="#009e73", linewidth=1)
        caption += f" Below the green line, {problem.success:g}, the problem counts as solved."
    save_figure(figure, out / "descent.png")
    return Picture(out / "descent.png", "Descent", caption)


def landscape_picture(
    problem: Problem, args: argparse.Namespace, plane: Plane, descent: Descent, method: str, out: Path, work: Work
) -> Picture:
    what = (problem, args.engine, plane)
    with work.piece(f"landscape, {args.size} x {args.size}", args.size**2, "reading or compiling") as report:
        surface = landscape(*what, args.size, out, report, **options_of(args))
    with work.piece(f"gradients, {ARROWS} x {ARROWS}", ARROWS**2, "reading or compiling") as report:
        arrows = gradient_field(*what, ARROWS, out, report, **options_of(args))
    path = plane.project(descent.setpoints)
    low, high = np.nanpercentile(np.where(np.isfinite(surface.costs), surface.costs, np.nan), (0, 98))
    figure = draw_landscape(
        surface,
        np.array(MaxNLocator(20).tick_values(low, high)),
        {method: (path, judged_costs(descent))},
        path[0],
        title=f"{problem.name} on {args.engine}",
        names=plane.names,
        arrows=arrows,
    )
    save_figure(figure, out / "landscape.png")
    caption = (
        f"J over {plane.names[0]} and {plane.names[1]}; all other variables are those of the best iterate (star). "
        "The path of the descent is projected on that plane, and arrows point against the gradient in it."
    )
    return Picture(out / "landscape.png", "Landscape", caption)


def motion_picture(problem: Problem, x: np.ndarray, engine: str, out: Path) -> Picture:
    how = viewing.film(problem, x, out / "motion.gif", engine=engine, size=PIXELS)
    return Picture(out / "motion.gif", "Motion", f"Under the best variables, {how}.")


def table_of(problem: Problem, x: np.ndarray) -> Table:
    columns = (problem.bound.names, problem.x0, x, *problem.limits)
    rows = [[name, *(f"{value:.4g}" for value in values)] for name, *values in zip(*columns, strict=True)]
    caption = f"The first {MOST} of {len(rows)}; best.npy has all." if len(rows) > MOST else ""
    return Table(["variable", "guess", "best", "least", "largest"], rows[:MOST], caption)


def run() -> None:
    run_main(main, "what was finished is kept, with --resume the same command continues")
