"""The motion of a problem as a file to look at."""

import copy
from pathlib import Path

from tog_mjx.drawing.viewing.animation import write_gif
from tog_mjx.drawing.viewing.rendering import render
from tog_mjx.drawing.viewing.shown import frame_times, motion_of, start
from tog_mjx.problems.library import get_problem
from tog_mjx.problems.problem import Problem
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import Numbers

SECONDS, FPS = 2.0, 25.0
"""How long a short motion is stretched to, and frames of a second of it."""


def film(
    problem: str | Problem, x: Numbers, path: str | Path, *, engine: str = "mjx", size: tuple[int, int] = (480, 360)
) -> str:
    """Writes the motion under the variables x [n] as a GIF, slowed down to `SECONDS` where it is shorter.

    Needs neither a display nor OpenGL. With `Starts` it is the motion from the first of them.

    Args:
      size: width and height.

    Returns:
      how it was made: by how much slower than it is, and by which renderer.

    Raises:
      InputError: for a motion that is not finite, variables, an engine or a problem that do not fit, and a path that
        does not end in .gif.

    Units: of x those of the problem's variables, of the size pixels.
    Gradient: none of a picture.
    Source: own.
    """
    if Path(path).suffix.lower() != ".gif":
        raise InputError(f"{path}: a film is a GIF; give a name that ends in .gif, or for a video use tog view --mp4")
    problem = get_problem(problem)
    model, motion = copy.copy(problem.scene.model), motion_of(problem, x, engine)
    duration = float(motion.time[-1])
    speed = min(1.0, duration / SECONDS)
    frames = render(model, start(model), motion.at(frame_times(duration, FPS, speed)), size)
    write_gif(Path(path), frames.images, FPS)
    pace = "as fast as it is" if speed == 1 else f"{1 / speed:.2g} times slower than it is"
    return f"{duration:.3g} s, {pace}; {frames.method}"
