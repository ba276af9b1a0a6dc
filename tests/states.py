"""States of one box and two fingers, drawn on purpose: free, sticking, sliding, or parting while still in contact.

Every contact of a state is the same kind, and no state is near a kink of the contact law.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from tog_mjx.mjcf.scene import Physics
from tog_mjx.problems import Problem, State
from tog_mjx.problems.state import Derived


def state_of_box(task: Problem, box: Any) -> State:
    """A State in which only the box's joints mean anything."""
    joints, box = task.scene.joints[:3], np.asarray(box, float)
    qpos, qvel = np.zeros(task.scene.model.nq), np.zeros(task.scene.model.nv)
    qpos[joints], qvel[joints] = box[:3], box[3:]
    time, positions, speeds, none = (jnp.asarray(some) for some in (0.0, qpos, qvel, qpos[:0]))
    return State(time, positions, speeds, none, none, task.scene.model, Derived("only the box's joints are known"))


KINDS = ("free", "sticking", "sliding", "parting")


def draw_state(kind: str, p: Physics, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Box [6] and fingers [2, 4]: fingers press both sides of the box, and one corner stands on the floor."""
    rng = np.random.default_rng(seed)
    half = p.box_half[0]
    tilt = rng.uniform(0.1, 0.3)
    c, s = np.cos(tilt), np.sin(tilt)
    frame = np.array([[c, -s], [s, c]])
    depth = rng.uniform(0.005, 0.01, 3) if kind != "free" else -rng.uniform(0.02, 0.05, 3)
    lowest = (frame @ p.corners.T)[1].min()
    centre = np.array([rng.normal(), -lowest - depth[0]])
    # Along the surfaces b_f v stays below or goes beyond mu f_n = 0.7 * (5 to 10 N); b_f is 9.81 to 25 N s/m.
    speed = {"free": 1.0, "sticking": 0.02, "sliding": 3.0, "parting": 0.02}[kind] * rng.uniform(0.8, 1.2, 3)
    # d_c v takes the spring's 5 to 10 N when bodies part at more than 0.2 m/s.
    parting = (1.0 if kind == "parting" else 0.0) + 0.01 * rng.normal(size=3)
    box = np.array([*centre, tilt, speed[0], parting[0], 0.05 * rng.normal()])
    fingers = []
    for i, side in enumerate((-1.0, 1.0)):
        local = np.array([side * (half + p.finger_radius - depth[i + 1]), rng.uniform(-0.1, 0.1)])
        velocity = np.array([side * parting[i + 1], (-1) ** i * speed[i + 1]])
        fingers.append([*(centre + frame @ local), *(box[3:5] + frame @ velocity)])
    return box, np.array(fingers)
