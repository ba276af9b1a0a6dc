"""Which touch-down, or parting, makes a motion jump where a variable moves by next to nothing."""

import contextlib
from collections import Counter

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.checks.measured.motion import Motion, Recorder
from tog_mjx.mjcf.supported import geoms_named, name_of
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.mjx_state import INPUTS, copy_of

NOTHING = 1e-9
"""Distance of two states that counts as none: the variables to either side of a jump differ by ten times as much."""
_LIMITS = {
    int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT): "joint",
    int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON): "tendon",
}


def touch_down(simulation: Recorder, before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]) -> str:
    """What begins or ceases to touch, and in which step, on one side of a jump alone: `before` and `after` are
    displacements to either side of it. Empty if nothing is found that does."""
    sides = [_Side(simulation, x) for x in (before, after)]
    motions = [side.run(simulation.scene.steps) for side in sides]
    apart = np.maximum(_distances(*motions), NOTHING)
    last = int((apart[1:] / apart[:-1]).argmax())  # The sample before they part most suddenly.
    first, stride = int(motions[0].times[last]), int(motions[0].times[last + 1] - motions[0].times[last])
    if stride > 1:
        motions = [side.run(stride, motion, last) for side, motion in zip(sides, motions, strict=True)]
        last = 0
    for i in range(last, last + stride):
        here, there = (side.acting(motion, i) for side, motion in zip(sides, motions, strict=True))
        if here != there:
            name, _ = ((here - there) + (there - here)).most_common(1)[0]
            step = first + i - last
            time = step * float(simulation.scene.model.opt.timestep)
            return f"{name} begin or cease to touch in step {step}, at {time:.3g} s, or not, as the variable moves"
    return ""


class _Side:
    """The motion at a displacement, and what acts in its states."""

    def __init__(self, simulation: Recorder, x: np.ndarray):
        self.simulation = simulation
        self.model, self.start = simulation.displaced(x)
        self.inputs = {name: self.start[name] for name in INPUTS}
        parameter, self.c_model = simulation.scene.x.parameter, simulation.scene.model
        if isinstance(self.model, mujoco.MjModel):
            self.c_model = self.model
        elif parameter:
            with contextlib.suppress(InputError):  # It gives names alone, and what it does not move hardly counts.
                self.c_model = parameter.in_c(parameter.value + x)

    def run(self, steps: int, motion: Motion | None = None, sample: int = 0) -> Motion:
        return self.simulation.run(self.model, steps, {**self.start, **(motion.at(sample) if motion else {})})

    def acting(self, motion: Motion, sample: int) -> Counter[str]:
        """Contacts (those of the engine) and limits that have a force in the step from a sample on, by name."""
        model = self.c_model
        one = self.run(1, motion, sample)
        names = [geoms_named(model, pair) for pair in one.geoms[one.distance < 0].tolist()]
        data = copy_of(model, self.simulation.scene.start, **self.inputs, **motion.at(sample))
        mujoco.mj_fwdPosition(model, data)
        for row, i in zip(data.efc_type.tolist(), data.efc_id.tolist(), strict=True):
            if kind := _LIMITS.get(row):
                names.append(f"{kind} {name_of(model, kind, i)} and its limit")
        return Counter(names)


def _distances(a: Motion, b: Motion) -> Float[np.ndarray, " S"]:
    """Of the states of two motions, at each sample."""
    return sum((np.linalg.norm(a.states[name] - b.states[name], axis=1) for name in ("qpos", "qvel")), np.zeros(()))
