"""Can the gradient of this scene be trusted? A preflight, a dozen checks, and one line: the verdict.

Any MJCF file, or a problem of your own, as my_problem.py:push. Exit status: 0 trust, 1 trust with
care, 3 do not trust, 2 for bad input.
"""

import argparse
import json
import sys
from pathlib import Path

import jax
from rich.console import Console
from rich.text import Text

from tog_mjx.checks.function_verdict import check
from tog_mjx.checks.scene_verdict import ENGINES, check_scene
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict
from tog_mjx.mjcf.keyframes import keyframe_start, saved_start
from tog_mjx.mjcf.scene import compile_model, scene_path
from tog_mjx.problems import Problem
from tog_mjx.problems.wrt import OF_DATA
from tog_mjx.running.console import ArgumentParser, run_main
from tog_mjx.running.errors import InputError, printable
from tog_mjx.running.storage import atomic_write, check_writable
from tog_mjx.running.user_code import load
from tog_mjx.stepping.implicit import STEPS as DIFFERENTIATIONS

STEPS = 100
_COLOURS = {Level.FINE: "green", Level.CARE: "yellow", Level.FAULT: "red"}


def main() -> None:
    args = parse_arguments()
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    is_problem = ":" in args.scene and not Path(args.scene).exists()
    path = Path(args.scene.partition(":")[0]) if is_problem else scene_path(args.scene)
    outputs, inputs = (args.json, args.html), [path, *([args.state] if args.state else [])]
    check_writable(*(output for output in outputs if output), inputs=inputs)
    with console.status("") as status:

        def report(name: str, finding: Finding | None) -> None:
            status.update(name)
            if finding:
                console.print(told(finding))

        verdict = _of_problem(args, report) if is_problem else _of_scene(args, path, report)
    print(printable(f"{path.stem}: {verdict.subject}: {verdict.line}"), flush=True)  # Writing may fail.
    if args.json:
        write_json(args.json, verdict)
    if args.html:
        from tog_mjx.drawing.report.verdict_page import write_verdict  # Libraries that draw take half a second to load.

        write_verdict(args.html, path.stem, verdict.line, verdict.as_json())
    sys.exit(verdict.exit_status)


def _of_scene(args: argparse.Namespace, path: Path, report: Report) -> Verdict:
    model = compile_model(path)
    start = saved_start(model, args.state) if args.state else keyframe_start(model, args.keyframe)
    return check_scene(
        model,
        start,
        steps=STEPS if args.steps is None else args.steps,
        wrt=args.wrt,
        output=load("cost", args.cost) if args.cost else "qpos" if args.output is None else args.output,
        differentiation=args.differentiation or "implicit",
        path=path,
        quick=args.quick,
        estimators=args.estimators,
        report=report,
        engine=args.engine,
    )


def _of_problem(args: argparse.Namespace, report: Report) -> Verdict:
    """In float64, as that of a scene."""
    for option in ("steps", "wrt", "output", "cost", "differentiation", "state", "keyframe"):
        if getattr(args, option) is not None:
            raise InputError(f"argument --{option}: a problem says that itself; leave it out")
    if args.quick:
        raise InputError("argument --quick: a problem's checks are quick ones; leave it out")
    with jax.enable_x64():
        return check(Problem.load(args.scene), estimators=args.estimators, report=report, engine=args.engine)


def parse_arguments() -> argparse.Namespace:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help="an MJCF file, or flip or grasp, or a problem: file.py:function")
    parser.add_argument("--steps", type=int, metavar="N", help=f"time steps (default: {STEPS})")
    default = "default: ctrl; of a scene without actuators, qvel"
    fields = "a field of mjx.Model, with what follows from it (field:NAME: alone)"
    parser.add_argument("--wrt", help=f"{', '.join(OF_DATA)} or {fields} ({default})")
    parser.add_argument("--output", help="qpos, qvel, acc, a site or a sensor (default: qpos)")
    parser.add_argument("--cost", metavar="FILE.py:FUNCTION", help="of the last mjx.Data; in place of --output")
    parser.add_argument("--engine", choices=ENGINES, default=ENGINES[0], help="mujoco: C MuJoCo (default: %(default)s)")
    parser.add_argument("--differentiation", choices=list(DIFFERENTIATIONS), help="default: implicit")
    begin = parser.add_mutually_exclusive_group()
    begin.add_argument("--state", type=Path, metavar="FILE", help="a .npz or .json with qpos, qvel, act, ctrl")
    begin.add_argument("--keyframe", metavar="NAME", help="default: start, else the first, else the initial pose")
    parser.add_argument("--quick", action="store_true", help="leave out float32, stock MJX, and what it costs")
    parser.add_argument("--estimators", action="store_true", help="ask too which gradient to follow: exact, stochastic")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the verdict there")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with the curves there")
    return parser.parse_args()


def told(finding: Finding) -> Text:
    """`str(finding)` in colours."""
    text = Text(str(finding))
    _, _, remedy = text.plain.partition("\n")
    text.stylize(_COLOURS[finding.level], 0, 5)
    text.stylize("bold", 6, 6 + len(finding.check))
    text.stylize("dim", len(text) - len(remedy))
    return text


def write_json(path: Path, verdict: Verdict) -> None:
    with atomic_write(path) as file:
        file.write(json.dumps(verdict.as_json(), indent=1, allow_nan=False).encode())


def run() -> None:
    run_main(main)
