"""A descent's iterate, read from the file of its run, and its motion on the simulator that found it."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tog_mjx.drawing.viewing import Motion
from tog_mjx.engines import check_names, precision, rollout
from tog_mjx.mjcf.scene import Scene
from tog_mjx.paper.tasks import Task, get_task
from tog_mjx.running.digests import scene_digest
from tog_mjx.running.errors import InputError
from tog_mjx.running.storage import DamagedFileError
from tog_mjx.solving.record import load_descent


class Iterate(NamedTuple):
    """Setpoints u [2F] (m) of iterate `number`, and its recorded cost J."""

    task: Task
    simulator: str
    number: int
    setpoints: Float[np.ndarray, " n"]
    cost: float


def read_iterate(path: Path, which: str | int = "best") -> Iterate:
    """An iterate of a run: "best", "last" or its number, the initial guess being 0.

    Raises:
      InputError: for a file that is missing or damaged, or was made with another scene or by no known simulator, and
        for an iterate that it lacks.
    """
    try:
        descent, settings = load_descent(path)
        task, simulator = get_task(settings["task"]), settings["simulator"]
        check_names(simulator, {})
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; name the .npz file of a run") from None
    except DamagedFileError as error:
        raise InputError(f"{error}: it is damaged, or no run of this program") from None
    except (KeyError, TypeError, InputError) as error:
        raise InputError(f"{path}: its settings are not those of a run ({' '.join(str(error).split())})") from None
    if settings.get("scene") != scene_digest(task.scene.model):
        raise InputError(f"{path} was made with another version of the scene {task.name}; run it again")
    last = descent.iterations
    number = {"best": descent.best_iteration, "last": last}.get(str(which), which)
    if not isinstance(number, int) or not 0 <= number <= last:
        raise InputError(f"{path} has no iterate {which}; it has 0 to {last}, best and last")
    setpoints = np.asarray(descent.setpoints[number], float)
    task.check(setpoints)
    return Iterate(task, simulator, number, setpoints, float(descent.costs[number]))


def replay(iterate: Iterate, duration: float | None = None) -> Motion:
    """The motion under an iterate's setpoints, on its own simulator, over the horizon or `duration` (s)."""
    task = iterate.task
    if duration is not None:
        steps = round(duration / task.scene.model.opt.timestep)
        task = dataclasses.replace(task, steps=steps)
    with precision(iterate.simulator):
        motion = rollout(task, iterate.setpoints, iterate.simulator)
        return Motion(np.asarray(motion.time, float), np.asarray(motion.qpos, float))


def poses(box: Float[np.ndarray, "*k 6"], fingers: Float[np.ndarray, "*k F 4"]) -> Float[np.ndarray, "*k c"]:
    """x, z, theta of the box, then x, z of each finger, of their states."""
    return np.concatenate([box[..., :3], fingers[..., :2].reshape(*box.shape[:-1], -1)], axis=-1)


def positions(
    scene: Scene, box: Float[np.ndarray, "*k 6"], fingers: Float[np.ndarray, "*k F 4"]
) -> Float[np.ndarray, "*k nq"]:
    """qpos of a planar scene in the states of its box and fingers."""
    qpos = np.tile(scene.model.qpos0, (*box.shape[:-1], 1))
    qpos[..., scene.joints] = poses(box, fingers)
    return qpos
