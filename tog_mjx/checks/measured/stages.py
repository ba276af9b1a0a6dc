"""Checks that read one motion: is all finite, what touches and how deep, what grows."""

from typing import Any

import mujoco
import numpy as np

from tog_mjx.checks.measured.motion import NEVER, QUANTITIES, Motion, Recorder
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.supported import geoms_named

GREAT = 1e3
"""Growth of a change of position over the horizon from which on it is told: a millimetre at the start is a metre at the
end, so that only steps of micrometres are as the gradient says. As much decay means that the start is forgotten."""
EXPLODED = 1e6
"""From here on it is a fault: a micrometre becomes a metre, and nobody knows a scene, or builds it, to a micrometre; in
float32 a rounding error of 1e-7 becomes a tenth of the motion."""
DEEP = 0.5
"""Penetration, relative to the smaller geom's half size: from the middle on the nearest way out is the other side, and
half-way there is a fair warning. It is no fault, as soft fingers sink so deep on purpose."""


def finite(motion: Motion) -> Finding:
    """Where NaN or infinity first appears: in which step, and in which of its stages."""
    for what, bad in (("value", motion.bad_value), ("gradient", motion.bad_slope)):
        first = int(bad.min())
        if first != NEVER:
            stage = QUANTITIES[int(bad.argmin())] if len(bad) == len(QUANTITIES) else ""
            remedy = (
                "the motion itself diverges: reduce the time step, or check the state"
                if what == "value"
                else "differentiate tog.step, which is finite there"
                if stage == "solver"
                else "see 'preflight'"
            )
            sentence = f"the {what} is NaN or infinite from step {first} on" + (stage and f", first in its {stage}")
            return Finding("finite", Level.FAULT, sentence, float(first), remedy)
    if not (np.isfinite(motion.value).all() and np.isfinite(motion.slopes).all()):
        remedy = "look at the cost: a norm or a root at zero needs a safe gradient"
        return Finding(
            "finite", Level.FAULT, "the motion is finite, but the output or its gradient is not", None, remedy
        )
    return Finding("finite", Level.FINE, "value and gradient are finite at every step")


def contacts(simulation: Recorder, motion: Motion) -> Finding:
    """How deep bodies sink into each other, or into the margin in which they already push each other."""
    if not motion.distance.size:
        return Finding("contacts", Level.FINE, "no two geoms of the scene can touch")
    closest = int(motion.distance.argmin())
    distance, at = float(motion.distance[closest]), int(motion.distance_step[closest])
    names, size = _met(simulation.scene.model, motion, closest)
    if distance >= 0:
        return Finding("contacts", Level.FINE, f"nothing touches: {names} come nearest, {distance:.2g} m", distance)
    depth = -distance / size
    model = simulation.scene.model
    margin = ", their margin included" if model.geom_margin.any() or model.pair_margin.any() else ""
    sentence = (
        f"{names} overlap by {-distance:.2g} m at most{margin}, in step {at}: "
        f"{depth:.0%} of the smaller one's half size"
    )
    if depth <= DEEP:
        return Finding("contacts", Level.FINE, sentence, depth)
    remedy = "stiffen the contact (solref), lighten the load, or start farther apart: deep inside, normals may flip"
    return Finding("contacts", Level.CARE, sentence, depth, remedy)


def untouched(simulation: Recorder, motion: Motion) -> str:
    """What comes nearest of all that does not touch."""
    distance = np.where(motion.distance >= 0, motion.distance, np.inf)
    if not np.isfinite(distance).any():
        return ""
    closest = int(distance.argmin())
    names, _ = _met(simulation.scene.model, motion, closest)
    what = "nothing is touched" if (motion.distance >= 0).all() else "no touch carries it there"
    return f"{what}; of what does not touch, {names} come nearest, {distance[closest]:.2g} m"


def _met(model: mujoco.MjModel, motion: Motion, contact: int) -> tuple[str, float]:
    """The two geoms of a candidate contact, and half the extent of the thinner one."""
    geoms = motion.geoms[contact].tolist()
    return geoms_named(model, geoms), min(_thickness(model, geom) for geom in geoms)


def _thickness(model: mujoco.MjModel, geom: int) -> float:
    """Half the least extent of a geom; a plane or height field has none."""
    kinds, kind = mujoco.mjtGeom, mujoco.mjtGeom(model.geom_type[geom])
    if kind in (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD):
        return np.inf
    radii = {kinds.mjGEOM_SPHERE: 1, kinds.mjGEOM_CAPSULE: 1, kinds.mjGEOM_CYLINDER: 2}
    return float(min(model.geom_size[geom][: radii.get(kind, 3)]))


def growth(simulation: Recorder, motion: Motion) -> Finding:
    """How a change of the initial positions grows or dies out, and how long a horizon is worth differentiating."""
    nv = simulation.scene.model.nv
    if nv == 0:
        return Finding("growth", Level.FINE, "nothing can move")
    block = motion.jacobians[:, :nv, :nv]
    is_finite = np.isfinite(block).all(axis=(1, 2))
    singular = np.linalg.svd(np.where(is_finite[:, None, None], block, 0.0), compute_uv=False)
    largest = np.where(is_finite, singular[:, 0], np.inf)
    beyond = np.flatnonzero(largest > GREAT)
    curves: dict[str, Any] = {
        "step": motion.times.tolist(),
        "largest singular value": largest.tolist(),
        "smallest singular value": np.where(is_finite, singular[:, -1], np.nan).tolist(),
        **{f"derivative along direction {i}": column.tolist() for i, column in enumerate(motion.moved.T[:3])},
    }
    most, last = float(largest.max()), float(largest[-1])
    faded = motion.times[largest < 1 / GREAT]
    if len(faded) and not len(beyond):
        sentence = (
            f"a change of the initial positions dies out: it falls below {1 / GREAT:.0e} of itself in step {faded[0]}, "
            "the longest horizon worth differentiating in the initial state"
        )
        is_asked = simulation.scene.x.array in ("qpos", "qvel")
        remedy = f"differentiate no more than {faded[0]} steps in the initial state; later ones do not feel it"
        level = Level.CARE if is_asked else Level.FINE
        return Finding("growth", level, sentence, last, remedy * is_asked, curves)
    if not len(beyond):
        sentence = f"a change of the initial positions grows at most {most:.2g} times, and is {last:.2g} at the end"
        return Finding("growth", Level.FINE, sentence, most, "", curves)
    horizon = int(motion.times[beyond[0]])
    sentence = (
        f"a change of the initial positions grows {most:.1e} times; it passes {GREAT:.0e} in step {horizon}, "
        "the longest horizon worth differentiating"
    )
    remedy = f"differentiate no more than {horizon} steps at a time (truncate, or optimise over several shooting nodes)"
    return Finding("growth", Level.FAULT if most > EXPLODED else Level.CARE, sentence, most, remedy, curves)
