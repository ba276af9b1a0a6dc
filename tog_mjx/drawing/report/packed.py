"""The motions behind the page: simulated here, packed into text, unpacked by the browser.

A motion is the poses x, z, theta of the box and x, z of each finger, every few time steps, in whole numbers of
`QUANTUM` (m or rad): the first pose, then the differences from one to the next, as little-endian 16-bit integers; of
all motions together, gzipped, in base64.
"""

import base64
import gzip
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.image
import numpy as np
from jaxtyping import Float, Int

from tog_mjx.drawing.figures.landscapes import LEVELS
from tog_mjx.engines.many import Motions, simulate_many
from tog_mjx.paper.tasks import Task
from tog_mjx.solving.descent import Descent
from tog_mjx.studies.landscape import Landscape

QUANTUM = 2.5e-4
"""In m and rad. A body is shown where it is to a quarter of a millimetre."""
FARTHEST = 4.0
"""In m and rad. What flies farther is held there, out of sight; so every difference of two poses fits into 16 bits."""
GRID, ITERATES, EVERY = 33, 2001, 10
"""Points of the window along each axis, iterates of a descent at most, time steps from one pose to the next."""


def scenario(
    task: Task,
    simulator: str,
    landscape: Landscape,
    descents: Mapping[str, Descent],
    report: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """All that the page needs to show a task on a simulator, as JSON: see `page.js` for its use."""
    points = task.plane.grid(GRID)
    chosen = {method: thinned(len(descent.costs)) for method, descent in descents.items()}
    setpoints = [np.array([task.expand(point) for point in points])]
    setpoints += [descents[method].setpoints[kept] for method, kept in chosen.items()]
    motions = simulate_many(task, simulator, np.concatenate(setpoints), EVERY, report)
    first, paths = len(points), {}
    for method, kept in chosen.items():
        paths[method] = {"first": first, "iterations": kept.tolist(), "best": descents[method].best_iteration}
        first += len(kept)
    physics = task.scene.physics
    return {
        "task": task.name,
        "simulator": simulator,
        "window": task.window,
        "grid": GRID,
        "landscape": picture(task, landscape),
        "setpoints": np.concatenate(setpoints).round(4).tolist(),
        "costs": [float(cost) if np.isfinite(cost) else None for cost in motions.costs],
        "paths": paths,
        "seconds": motions.time.round(6).tolist(),
        "quantum": QUANTUM,
        "motions": pack(motions),
        "view": _view(task, [descent.setpoints_best for descent in descents.values()]),
        "half": physics.box_half.tolist(),
        "radius": physics.finger_radius,
    }


def thinned(number: int) -> Int[np.ndarray, " k"]:
    """Of iterates 0 to number - 1, at most `ITERATES`, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, number - 1, min(number, ITERATES)).round().astype(int))


def pack(motions: Motions) -> str:
    """See the module's header."""
    fingers = motions.fingers[..., :2].reshape(*motions.fingers.shape[:2], -1)
    poses = np.nan_to_num(np.concatenate([motions.box[..., :3], fingers], axis=-1), posinf=FARTHEST, neginf=-FARTHEST)
    whole = np.rint(np.clip(poses, -FARTHEST, FARTHEST) / QUANTUM).astype(np.int32)
    steps = np.diff(whole, axis=1, prepend=0)
    return base64.b64encode(gzip.compress(steps.astype("<i2").tobytes(), mtime=0)).decode()


def unpack(text: str, shape: tuple[int, int, int]) -> Float[np.ndarray, "N k c"]:
    """The poses of a packed text, as the browser reads them."""
    steps = np.frombuffer(gzip.decompress(base64.b64decode(text)), "<i2").reshape(shape)
    return np.cumsum(steps, axis=1, dtype=np.int32) * QUANTUM


def picture(task: Task, landscape: Landscape) -> str:
    """The landscape in the colours of Figures 2 and 5, a pixel a point, as the address of a PNG image."""
    levels, file = LEVELS[task.name], io.BytesIO()
    matplotlib.image.imsave(
        file, landscape.costs, cmap="cividis", vmin=levels[0], vmax=levels[-1], origin="lower", format="png"
    )
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


def _view(task: Task, best: Sequence[Float[np.ndarray, " n"]]) -> list[float]:
    """x_min, x_max, z_min, z_max of the view: start and goal, the landscape's setpoints, and the best ones."""
    box, fingers = task.scene.start
    margin = 0.1 + float(np.linalg.norm(task.scene.physics.box_half))
    setpoints = np.concatenate([np.reshape(u, (-1, 2)) for u in best])
    (x_min, x_max), (_, z_max) = task.window
    x = [box[0] - margin, box[0] + margin, task.goal[0] - margin, task.goal[0] + margin, x_min - 0.1, x_max + 0.1]
    x += [*(fingers[:, 0] - 0.1), *(setpoints[:, 0] - 0.1), *(setpoints[:, 0] + 0.1)]
    z = [z_max + 0.1, task.goal[1] + margin, *(setpoints[:, 1] + 0.1)]
    x, z = np.clip(x, -FARTHEST, FARTHEST), np.clip(z, 0, FARTHEST)
    return [float(x.min()), float(x.max()), -0.1, float(z.max())]
