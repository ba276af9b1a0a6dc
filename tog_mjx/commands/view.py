"""Look at a scene, or at the motion that a run found: in a window, in a web browser, or as a GIF or a video.

Without --run, C MuJoCo simulates the scene under constant setpoints. With --run, the motion is that of the simulator
which made the result. Of a problem, as my_problem.py:push, it is that of MJX under its guess, or under the numbers of
--x.
"""

import argparse
import copy
from pathlib import Path

import numpy as np

from tog_mjx.drawing import viewing
from tog_mjx.engines import choose_engine
from tog_mjx.mjcf.scene import compile_model, scene_path
from tog_mjx.paper.replay import Iterate, read_iterate, replay
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.problems import Problem
from tog_mjx.running.console import ArgumentParser, run_main, within
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import check_writable

DURATION = 2.0
"""Seconds shown of a scene that is not a task's."""
SLOW = 0.25
"""Speed of an animation of a task: its motion lasts half a second."""


def main() -> None:
    args = parse_arguments()
    problem = Problem.load(args.scene) if is_problem(args.scene) else None
    path = Path(args.scene.rpartition(":")[0]) if problem else scene_path(args.scene)
    task = next((name for name in TASKS if scene_path(name).resolve() == path.resolve()), None)
    model = copy.copy(problem.scene.model) if problem else compile_model(path)
    setpoints, motion = None if args.setpoints is None else np.array(args.setpoints), None
    data = viewing.start(model, setpoints)
    check_writable(*args.files, inputs=[path, *(given for given in (args.run, args.x) if given)])
    if args.mp4:
        viewing.check_video(tuple(args.size))
    if not (args.files or args.web):
        viewing.check_display()
    if args.run:
        iterate = read_iterate(args.run, args.iterate)
        if iterate.task.name != task:
            raise InputError(f"{args.run} is a run of the task {iterate.task.name}; give that as the scene, not {path}")
        print(told(iterate), flush=True)
        data = viewing.start(model, iterate.setpoints)
        motion = replay(iterate, args.duration)
    if problem:
        x = viewing.read_numbers(args.x) if args.x else problem.x0
        choice = choose_engine(problem, gradients=1)
        print(f"on {choice.engine}: {choice.reason}", flush=True)
        motion = viewing.motion_of(problem, x, choice.engine)
    if args.files:
        duration = args.duration or (horizon(task) if task else DURATION)
        animate(args, model, data, motion or viewing.simulate(model, data, duration), SLOW if task else 1.0)
        return
    speed = args.speed or 1.0
    playback = viewing.Loop(model, data, motion, speed) if motion else viewing.Live(model, data, speed)
    if args.web:
        viewing.show_in_browser(playback, args.port)
    else:
        viewing.show_in_window(playback)


def parse_arguments() -> argparse.Namespace:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help=f"{', '.join(TASKS)}, the path of any MJCF file, or a problem: file.py:function")
    what = parser.add_mutually_exclusive_group()
    default = "default: those of the keyframe start, else of the first keyframe, else 0"
    each = "one of each actuator; of a task: x and z of each finger in m"
    what.add_argument("--setpoints", type=float, nargs="+", metavar="U", help=f"{each} ({default})")
    what.add_argument("--run", type=Path, metavar="RESULT.npz", help="show the motion of a run of tog reproduce")
    what.add_argument("--x", type=Path, metavar="FILE.npy", help="the variables of a problem (default: its guess)")
    iterate = "of the run; 0 is the initial guess (default: best)"
    parser.add_argument("--iterate", type=which, metavar="best|last|N", help=iterate)
    where = parser.add_argument_group("where to show it (default: a window)")
    where.add_argument("--web", action="store_true", help="serve a page for a browser, to other computers too")
    where.add_argument("--port", type=within(int, 0, 65535), metavar="N", help="default: the first free from 8080 on")
    where.add_argument("--gif", type=Path, metavar="FILE", help="write an animated GIF")
    where.add_argument("--mp4", type=Path, metavar="FILE", help="write a video; it needs pip install imageio-ffmpeg")
    how = parser.add_argument_group("how")
    seconds = f"default: the task's horizon, else {DURATION:g} s"
    how.add_argument("--duration", type=within(float, 0.001, 600), metavar="S", help=seconds)
    how.add_argument("--fps", type=within(float, 1, 100), metavar="N", help="default: 25")
    rate = f"default: 1, real time; {SLOW:g} for a file of a task"
    how.add_argument("--speed", type=within(float, 0.01, 100), metavar="R", help=rate)
    how.add_argument("--size", type=within(int, 16, 4096), nargs=2, metavar=("W", "H"), help="default: 640 360")
    return check(parser, parser.parse_args())


def check(parser: ArgumentParser, args: argparse.Namespace) -> argparse.Namespace:
    """Options that mean nothing together are refused, not ignored; defaults are filled in."""
    args.files = [file for file in (args.gif, args.mp4) if file]
    for option in ("setpoints", "run", "duration"):
        if is_problem(args.scene) and getattr(args, option) is not None:
            parser.error(f"argument --{option}: a problem has its own; leave it out")
    if args.x and not is_problem(args.scene):
        parser.error("argument --x: it is of a problem, file.py:function")
    for option, needed, present in (
        ("iterate", "--run", args.run),
        ("port", "--web", args.web),
        ("fps", "--gif or --mp4", args.files),
        ("size", "--gif or --mp4", args.files),
        ("duration", "--gif, --mp4 or --run", args.files or args.run),
    ):
        if getattr(args, option) is not None and not present:
            parser.error(f"argument --{option}: it needs {needed}")
    if args.web and args.files:
        parser.error("argument --web: give it, or --gif and --mp4")
    if args.web and args.speed and not (args.run or is_problem(args.scene)):
        parser.error("argument --speed: choose the speed of a live simulation on the page of --web")
    defaults = {"iterate": "best", "port": 0, "fps": 25.0, "size": [640, 360]}
    for option, value in defaults.items():
        if getattr(args, option) is None:
            setattr(args, option, value)
    return args


def is_problem(scene: str) -> bool:
    return ":" in scene and not Path(scene).exists()


def which(text: str) -> str | int:
    if text in ("best", "last"):
        return text
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is neither best nor last nor the number of an iterate")
    return int(text)


def horizon(task: str) -> float:
    chosen = get_task(task)
    return (chosen.steps) * chosen.scene.model.opt.timestep


def told(iterate: Iterate) -> str:
    u = ", ".join(f"{x:.4g}" for x in iterate.setpoints)
    return f"iterate {iterate.number} on {iterate.simulator}: setpoints ({u}), J = {iterate.cost:.4g}"


def animate(args: argparse.Namespace, model, data, motion: viewing.Motion, speed: float) -> None:
    """Writes the files that were asked for, and says how their frames were made."""
    times = viewing.frame_times(float(motion.time[-1]), args.fps, args.speed or speed)
    frames = viewing.render(model, data, motion.at(times), tuple(args.size))
    for file, write in ((args.gif, viewing.write_gif), (args.mp4, viewing.write_mp4)):
        if file:
            write(file, frames.images, args.fps)
            print(f"{file}: {len(times)} frames, {file.stat().st_size / 1000:.0f} kB, {frames.method}")


def run() -> None:
    run_main(main)
