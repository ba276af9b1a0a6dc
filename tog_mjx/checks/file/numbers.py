"""Numbers in a scene that spoil gradients: time constants, limits that are met, and ties. As `spoilers`."""

import copy
from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from tog_mjx.checks.file.spoilers import AGREEMENT, COARSE, Question, Spoiler, of_one
from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.parameter import ALONE
from tog_mjx.mjcf.supported import Culprit, candidates, geoms_named, name_of
from tog_mjx.mjcf.unused import frictions
from tog_mjx.stepping._mjx import FLUID

_OFF = mujoco.mjtDisableBit
_EXACTLY = 1e-9
"""Distances, in m or rad, that are zero: those of poses given in decimals, after rounding. A kink farther away is met
by steps of a descent, but not by the derivative."""
TIME_STEP = "time step"
_STAYS = 10
"""Time steps after which a joint has stayed where it was: under any acceleration above 2e-5 m/s^2 at 1 ms it has left
by more than `_EXACTLY`."""
_UNMOVED = 1e-12
"""Inverse weight, in 1/kg, that is zero but for rounding: no body weighs 1e12 kg."""


class _Law(NamedTuple):
    """The solref of a constraint, and the elements that give it."""

    name: str
    elements: tuple[tuple[str, int], ...]
    solref: tuple[float, float]


def _laws(model: mujoco.MjModel) -> Iterator[_Law]:
    """Of all that makes constraints."""
    off = model.opt.disableflags
    for first, second, pair in candidates(model):
        geoms = (("geom", first), ("geom", second))
        name = f"the contact of {geoms_named(model, (first, second), ' with ')}"
        solref = model.pair_solref[pair] if pair >= 0 else _mixed_solref(model, first, second)
        yield _Law(name, (("pair", pair),) if pair >= 0 else geoms, tuple(solref))
    for kind, flag, fields in (
        ("joint", _OFF.mjDSBL_LIMIT, (model.jnt_limited, model.jnt_solref)),
        ("tendon", _OFF.mjDSBL_LIMIT, (model.tendon_limited, model.tendon_solref_lim)),
        ("equality", _OFF.mjDSBL_EQUALITY, (np.ones(model.neq), model.eq_solref)),
    ):
        for i in [] if off & (flag | _OFF.mjDSBL_CONSTRAINT) else np.flatnonzero(fields[0]).tolist():
            yield _Law(f"{kind} {name_of(model, kind, i)}", ((kind, i),), tuple(fields[1][i]))


def _mixed_solref(model: mujoco.MjModel, first: int, second: int) -> np.ndarray:
    """MuJoCo's rule: that of the higher priority; the mean by solmix of standard ones, the least of direct ones."""
    priority, solref = model.geom_priority[[first, second]], model.geom_solref[[first, second]]
    if priority[0] != priority[1]:
        return solref[priority.argmax()]
    if (solref[:, 0] <= 0).any():
        return solref.min(axis=0)
    weights = model.geom_solmix[[first, second]]
    return np.average(solref, axis=0, weights=weights if weights.sum() > 0 else None)


def stiff_constraints(question: Question) -> Iterator[Spoiler]:
    """Constraints faster than the time step can follow, and those that MuJoCo slows down in silence: each law once."""
    dt = question.model.opt.timestep
    is_safe = not question.model.opt.disableflags & _OFF.mjDSBL_REFSAFE
    found: dict[tuple[float, float], list[_Law]] = {}
    for law in _laws(question.model):
        found.setdefault(law.solref, []).append(law)
    for (first, second), laws in found.items():
        name = laws[0].name + (f" and {len(laws) - 1} more" if len(laws) > 1 else "")
        rate = 1 / (first * second) if first > 0 and second > 0 else np.sqrt(max(-first, 0.0))
        if is_safe and 0 < first < 2 * dt:
            what = f"solref of {name}: its time constant {first:g} s is taken as 2 time steps, {2 * dt:g} s"
            remedy = f"give {2 * dt:g} or more, or a shorter time step: the derivative in it is zero"
        elif rate * dt > COARSE:
            what, remedy = f"solref of {name}: {_told(rate, dt)}", _finer(rate)
        else:
            continue
        measured_by = "" if "solref" in question.array else TIME_STEP
        yield Spoiler(Culprit(what, laws[0].elements), remedy, measured_by=measured_by)


def stiff_springs(question: Question) -> Iterator[Spoiler]:
    """Springs and servos of joints that turn by too much of a period in a time step."""
    model = question.model
    dofs = model.jnt_dofadr
    for what, kind, numbers, stiffness, joints in (
        ("stiffness", "joint", np.arange(model.njnt), model.jnt_stiffness, np.arange(model.njnt)),
        ("kp", "actuator", *_servos(model)),
    ):
        for i, spring, joint in zip(numbers.tolist(), stiffness, joints, strict=True):
            rate = float(np.sqrt(spring * model.dof_invweight0[dofs[joint]]))
            if rate * model.opt.timestep > COARSE:
                told = f"{what} of {{}}: {_told(rate, model.opt.timestep)}"
                yield of_one(model, kind, i, told, _finer(rate), TIME_STEP)


def _servos(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Actuators of joints with a force that falls with the position: numbers, stiffness at the joint, joints."""
    stiffness = -model.actuator_biasprm[:, 1] * model.actuator_gear[:, 0] ** 2
    numbers = np.flatnonzero((model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (stiffness > 0))
    return numbers, stiffness[numbers], model.actuator_trnid[numbers, 0]


def _told(rate: float, dt: float) -> str:
    return f"a vibration of {rate:.3g} rad/s, {rate * dt:.2g} rad a time step, is too coarsely stepped"


def _finer(rate: float) -> str:
    return f"set <option timestep> to {COARSE / rate:.2g} s or less, or soften it"


def saturated_actuators(question: Question) -> Iterator[Spoiler]:
    """Controls and forces at or beyond their limits in this state."""
    model, data = question.model, question.data
    asked = question.chosen if question.array == "ctrl" else np.full(model.nu, not question.array)
    clamps = asked & (model.actuator_ctrllimited != 0) & (not model.opt.disableflags & _OFF.mjDSBL_CLAMPCTRL)
    for what, limited, limits, values in (
        ("control", clamps, model.actuator_ctrlrange, data.ctrl),
        ("force", model.actuator_forcelimited, model.actuator_forcerange, data.actuator_force),
    ):
        for i in np.flatnonzero(limited).tolist():
            low, high = limits[i]
            if low < values[i] < high:
                continue
            is_kink = what == "control" and values[i] in (low, high)
            why = "another derivative to either side" if is_kink else "the derivative in the control is zero"
            told = f"the {what} of {{}}, {values[i]:g}, is at its limit: {why}"
            remedy = f"keep it between {low:g} and {high:g}"
            yield of_one(model, "actuator", i, told, remedy, AGREEMENT if is_kink else "")


def touching_exactly(question: Question) -> Iterator[Spoiler]:
    """Of two geoms with several contact points once."""
    met = {tuple(contact.geom.tolist()) for contact in question.data.contact if _is_kink(contact)}
    for pair in sorted(met):
        names = geoms_named(question.model, pair, " with ")
        what = f"{names}: they touch exactly in this state, where the law of the contact has its kink"
        elements = tuple(("geom", geom) for geom in pair)
        yield Spoiler(
            Culprit(what, elements), "start above, or in the equilibrium a little deep", measured_by=AGREEMENT
        )


def _is_kink(contact: mujoco.MjContact) -> bool:
    """Forces begin at the margin."""
    return abs(contact.dist - contact.includemargin) <= _EXACTLY


def limits_met(question: Question) -> Iterator[Spoiler]:
    """Joints exactly at their limits, as where a range ends at the initial pose; one remark for all of them.

    For a derivative in their own positions all of them; else those that stay, as one that leaves at once is pushed off
    its kink.
    """
    model, data = question.model, copy.copy(question.data)
    met = stay = _at_limits(model, data)
    asked = question.chosen if question.array == "qpos" else np.full(model.nv, not question.array)
    moved = set(model.dof_jntid[asked].tolist())
    for _ in range(_STAYS if met - moved else 0):
        mujoco.mj_step(model, data)
        stay = stay & _at_limits(model, data)
    if met := (met & moved) | stay:
        first, more = min(met), f" and {len(met) - 1} more" if len(met) > 1 else ""
        what = f"joint {name_of(model, 'joint', first)}{more}: exactly at its limit"
        culprit = Culprit(f"{what}, with another derivative to either side", tuple(("joint", i) for i in sorted(met)))
        yield Spoiler(culprit, "start within the range", measured_by=AGREEMENT)


def _at_limits(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    if model.opt.disableflags & (_OFF.mjDSBL_LIMIT | _OFF.mjDSBL_CONSTRAINT):
        return set()
    joints = np.flatnonzero((model.jnt_limited != 0) & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)))
    low, high = model.jnt_range[joints].T
    position = data.qpos[model.jnt_qposadr[joints]]
    left = np.minimum(position - low, high - position) - model.jnt_margin[joints]
    return set(joints[np.abs(left) <= _EXACTLY].tolist())


def ties(question: Question) -> Iterator[Spoiler]:
    """A contact takes the larger friction of its geoms: where they are equal, the derivative is one-sided."""
    model, asked = question.model, question.chosen
    if question.array != "geom_friction":
        return
    tied = []
    for first, second, pair in candidates(model):
        is_even = pair < 0 and model.geom_priority[first] == model.geom_priority[second]
        is_equal = model.geom_friction[first] == model.geom_friction[second]
        is_equal[frictions(model, first, second) :] = False
        if is_even and (is_equal & (asked[first] | asked[second])).any():
            tied.append((first, second))
    if tied:
        names = geoms_named(model, tied[0])
        more = f" and of {len(tied) - 1} more pairs" if len(tied) > 1 else ""
        what = f"the friction of {names}{more} is equal, and a contact takes the larger: a kink"
        yield Spoiler(Culprit(what, tuple(("geom", geom) for geom in tied[0])), "make one of them larger")


_ROWS = {
    "dof_frictionloss": lambda model: model.dof_frictionloss > 0,
    "tendon_frictionloss": lambda model: model.tendon_frictionloss > 0,
    "jnt_range": lambda model: model.jnt_limited != 0,
    "tendon_range": lambda model: model.tendon_limited != 0,
}


def absent(question: Question) -> Iterator[Spoiler]:
    """Parameters of constraints that are not there."""
    model, array, asked = question.model, question.array, question.chosen
    if array in _ROWS and (missing := int((asked.reshape(len(asked), -1).any(axis=1) & ~_ROWS[array](model)).sum())):
        what = f"{array}: {missing} of its entries are of no constraint, so their derivative is zero"
        remedy = "give the scene a small friction loss, or a limit, where one is meant"
        yield Spoiler(Culprit(what), remedy, measured_by="zeros" if array in ("jnt_range", "tendon_range") else "")


def without_fluid(question: Question) -> Iterator[Spoiler]:
    """Parameters of forces that MJX lacks."""
    model, array = question.model, question.array
    if array in FLUID and model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        what = f"{array}: with the integrator implicitfast MJX has no fluid, so its derivative is zero"
        yield Spoiler(Culprit(what), "set integrator='Euler'")


def followers(question: Question) -> Iterator[Spoiler]:
    """What moves with a parameter, and what should and does not."""
    parameter = question.parameter
    if parameter is None:
        return
    along = sorted(set(parameter.followers.rates) - {parameter.array})
    behind = parameter.followers.behind
    name = parameter.name.removeprefix(ALONE)
    if parameter.is_alone:
        if along or behind:
            what = f"{name} moves alone, as asked for: {', '.join(sorted({*along, *behind}))} stay as they are"
            yield Spoiler(Culprit(what), f"without '{ALONE}' they move along", Level.FINE)
    elif behind:
        what = f"{name} leaves behind what the compiler derives from it: {', '.join(behind)}"
        remedy = "give the model's own MJCF file or MjSpec, without a <frame> about the element, or recompile"
        yield Spoiler(Culprit(what), remedy)
    elif along:
        what = f"{name} moves along, to first order, what the compiler derives from it: {', '.join(along)}"
        yield Spoiler(Culprit(what), f"'{ALONE}{name}' is the array alone", Level.FINE)


def infinite_stiffness(question: Question) -> Iterator[Spoiler]:
    """Contacts that cannot move what they meet: the inverse weight, by which they are scaled, is zero."""
    model = question.model
    bodies = {int(model.geom_bodyid[geom]) for first, second, _ in candidates(model) for geom in (first, second)}
    for body in sorted(bodies):
        if model.body_weldid[body] and model.body_invweight0[body, 0] < _UNMOVED:
            told = "{}: a force at its centre does not move it, so that its contacts are infinitely stiff"
            remedy = "shift its centre of mass from the joint a little, or leave its contacts out"
            yield of_one(model, "body", body, told, remedy)


OF_MJX = (without_fluid,)
DETECTORS = (
    stiff_constraints, stiff_springs, saturated_actuators, touching_exactly, limits_met, infinite_stiffness, ties,
    absent, followers,
)  # fmt: skip
