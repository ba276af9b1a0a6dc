"""What is known to spoil gradients, though MJX simulates it: one small detector each, read from the model alone.

Each yields the culprits, with what to do; what they claim is measured in the tests.
"""

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool

from tog_mjx.checks.told.finding import Level
from tog_mjx.mjcf.parameter import Parameter
from tog_mjx.mjcf.supported import Culprit, candidates, geoms_named, has_constraints, has_fluid, name_of, type_of
from tog_mjx.stepping.unrolled import LOOSE, SHORT_SEARCH


class Question(NamedTuple):
    """What is asked: a model, its state (MuJoCo has computed its positions, contacts and forces), the array that the
    variables of the derivative are of ("" if not known), which of its numbers they are, how the step is differentiated,
    and what moves with the variables, where they are of the model."""

    model: mujoco.MjModel
    data: mujoco.MjData
    array: str
    chosen: Bool[np.ndarray, "..."]
    differentiation: str
    parameter: Parameter | None = None


class Spoiler(NamedTuple):
    """A culprit, the remedy, how much it weighs, and the name of the check that measures whether it does, if one."""

    culprit: Culprit
    remedy: str
    level: Level = Level.CARE
    measured_by: str = ""


def of_one(model: mujoco.MjModel, kind: str, i: int, told: str, remedy: str, check: str = "") -> Spoiler:
    """One element is the culprit: `told` has "{}" where its kind and name belong; `check` measures whether it is."""
    return Spoiler(Culprit(told.format(f"{kind} {name_of(model, kind, i)}"), ((kind, i),)), remedy, measured_by=check)


AGREEMENT = "agreement"
_OWN_CONTACTS = {
    frozenset(pair)
    for pair in (
        ("plane", "box"), ("plane", "mesh"), ("plane", "cylinder"), ("box",), ("box", "mesh"), ("mesh",),
        ("capsule", "box"), ("capsule", "mesh"),
    )
}  # fmt: skip
_ITERATED = ("cylinder", "ellipsoid")
"""Met by anything but a plane, MJX finds the nearest points by a fixed number of iterations."""
_MANY_VERTICES = 200
"""Of a hull: MJX goes through pairs of edges, so that time and memory grow with the square."""
EQUALITY_REMEDY = "use a joint, or a shorter time constant in its solref, by which it gives way less"
_FEW_ITERATIONS = {mujoco.mjtSolver.mjSOL_NEWTON: 5, mujoco.mjtSolver.mjSOL_CG: 20, mujoco.mjtSolver.mjSOL_PGS: 20}
"""Fewer may leave contacts unconverged. Whether they do, the check of the solver measures, in every scene: nothing is
lost if this is told in vain, or not told."""
COARSE = 0.3
"""Of a frequency times the time step: semi-implicit Euler's error of the phase is its square over 24, a period: 0.4 %,
or after 60 periods a quarter of one, where a derivative that was largest is zero."""
_COINCIDE = 1e-8
"""m. MJX takes lengths below for zero."""
_FAR = 1e3
"""m. In float32 a position is rounded to 1e-7 of it, and contacts are 1e-4 m deep."""


def collisions(question: Question) -> Iterator[Spoiler]:
    """Contacts whose points jump: each kind of them once, with the geoms of the first."""
    model = question.model
    found: dict[frozenset[str], list[tuple[int, int]]] = {}
    for first, second, _ in candidates(model):
        found.setdefault(frozenset((type_of(model, first), type_of(model, second))), []).append((first, second))
    for kinds, pairs in found.items():
        if kinds in _OWN_CONTACTS or "hfield" in kinds:
            why, check = "MJX chooses its points by a rule that jumps, and otherwise than C MuJoCo", ""
            remedy = "put a small sphere at each corner, or use capsules, which have smooth contacts"
        elif "plane" not in kinds and any(kind in kinds for kind in _ITERATED):
            why, check = "MJX finds its points by a few iterations, otherwise than C MuJoCo", "parity"
            remedy = "build the shape of spheres and capsules, which have closed forms"
        else:
            continue
        names = " with ".join(f"geom {name_of(model, 'geom', geom)} ({type_of(model, geom)})" for geom in pairs[0])
        more = f" and {len(pairs) - 1} more such pairs" if len(pairs) > 1 else ""
        yield Spoiler(Culprit(f"the contact of {names}{more}: {why}", _geoms(pairs[0])), remedy, measured_by=check)


def large_meshes(question: Question) -> Iterator[Spoiler]:
    model = question.model
    for geom in sorted({geom for pair in candidates(model) for geom in pair[:2]}):
        if type_of(model, geom) == "mesh":
            graph = model.mesh_graphadr[model.geom_dataid[geom]]
            count = int(model.mesh_graph[graph]) if graph >= 0 else 0
            if count > _MANY_VERTICES:
                told = f"{{}} collides by a hull of {count} vertices: slow on MJX"
                yield of_one(model, "geom", geom, told, "set the mesh's maxhullvert, or use primitives")


def contact_limits(question: Question) -> Iterator[Spoiler]:
    model = question.model
    for i in range(model.nnumeric):
        name = model.numeric(i).name
        if name in ("max_contact_points", "max_geom_pairs") and model.numeric(i).data[0] >= 0:
            what = f"<numeric name='{name}'>: MJX keeps the nearest contacts alone, and the choice jumps"
            yield Spoiler(Culprit(what), "leave it out, or give a number that is never reached")


def native(question: Question) -> Iterator[Spoiler]:
    """Where only stock `mjx.step` fails."""
    model = question.model
    if question.differentiation != "native":
        return
    remedy = "differentiate tog.step"
    if model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and candidates(model):
        what = "<option cone='elliptic'>: the derivative of stock mjx.step is NaN as soon as a contact is open"
        yield Spoiler(Culprit(what, attribute="cone"), remedy, Level.FAULT)
    for i in np.flatnonzero(model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)).tolist():
        first, size = int(model.jnt_dofadr[i]), 6 if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE else 3
        if not question.data.qvel[first + size - 3 : first + size].any():
            told = "{} does not rotate: stock mjx.step drops a derivative there"
            yield of_one(model, "joint", i, told, f"{remedy}, or give it an angular velocity", AGREEMENT)
    low, high = model.tendon_lengthspring.T
    rests = (model.tendon_stiffness > 0) & (low == high) & (question.data.ten_length == low)
    for i in np.flatnonzero(rests).tolist():
        told = "{} is at its rest length: stock mjx.step drops its spring's derivative"
        yield of_one(model, "tendon", i, told, f"{remedy}, or begin elsewhere", AGREEMENT)


def solver(question: Question) -> Iterator[Spoiler]:
    option = question.model.opt
    if not has_constraints(question.model):
        return
    few = _FEW_ITERATIONS[int(option.solver)]
    for attribute, least in (("iterations", few), ("ls_iterations", SHORT_SEARCH)):
        if (given := getattr(option, attribute)) < least:
            what = f"<option {attribute}='{given}'>: the solver may stop before it has converged"
            remedy = "give 50 or more, and the motion and its gradient are those of the scene, not of the solver"
            yield Spoiler(Culprit(what, attribute=attribute), remedy, measured_by="solver")
    if option.tolerance > LOOSE:
        what = f"<option tolerance='{option.tolerance:g}'>: the solver may stop before it has converged"
        yield Spoiler(Culprit(what, attribute="tolerance"), "give 1e-8 or less", measured_by="solver")


def passive_flags(question: Question) -> Iterator[Spoiler]:
    """With either flag MJX leaves out springs, dampers, gravity compensation and fluid forces all together."""
    model, off = question.model, mujoco.mjtDisableBit
    has_damping = model.dof_damping.any() or model.tendon_damping.any()
    has_others = model.body_gravcomp.any() or has_fluid(model)
    has_springs = model.jnt_stiffness.any() or model.tendon_stiffness.any()
    flags = (off.mjDSBL_SPRING, "spring", has_damping), (off.mjDSBL_DAMPER, "damper", has_springs)
    for flag, name, is_other in flags:
        if model.opt.disableflags & flag and (is_other or has_others):
            what = f"<flag {name}='disable'>: MJX leaves out all passive forces then, damping and springs alike"
            remedy = f"set the scene's {'stiffness' if name == 'spring' else 'damping'} to zero instead"
            yield Spoiler(Culprit(what, attribute=name), remedy, Level.FAULT)


def differences_from_c(question: Question) -> Iterator[Spoiler]:
    """Small ones, and those that come with time."""
    model = question.model
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        yield Spoiler(Culprit("<flag sleep='enable'>: on MJX no body sleeps", attribute="sleep"), "disable it")
    for i in np.flatnonzero(model.actuator_actearly).tolist():
        yield of_one(model, "actuator", i, "actearly of {}: MJX applies the activation one step later", "leave it out")
    for kind, prefix in (("joint", "jnt"), ("tendon", "tendon")):
        limited, span = getattr(model, f"{prefix}_limited"), np.ptp(getattr(model, f"{prefix}_range"), axis=1)
        for i in np.flatnonzero((limited != 0) & (span < 2 * getattr(model, f"{prefix}_margin"))).tolist():
            told = "{} is within the margin of both limits: MJX sees the nearer alone"
            yield of_one(model, kind, i, told, "reduce the margin")


def upright_capsules(question: Question) -> Iterator[Spoiler]:
    """On the pyramidal cone friction depends on the axes of the contact, which C MuJoCo chooses otherwise."""
    model, data = question.model, question.data
    if model.opt.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL:
        return
    touching = sorted({tuple(contact.geom.tolist()) for contact in data.contact if contact.dim > 1})
    for plane, geom in touching:
        if (type_of(model, plane), type_of(model, geom)) != ("plane", "capsule"):
            continue
        axes = [data.geom_xmat[some].reshape(3, 3)[:, 2] for some in (plane, geom)]
        if abs(axes[0] @ axes[1]) > np.sqrt(3) / 2:
            what = f"{geoms_named(model, [geom])} (capsule) stands on {geoms_named(model, [plane])}"
            what += ": the axes of its friction pyramid are not those of C MuJoCo, and jump as it tilts by 30 degrees"
            yield Spoiler(Culprit(what, (("geom", geom),)), "set cone='elliptic', which has no axes")


def far_away(question: Question) -> Iterator[Spoiler]:
    model = question.model
    for body in range(1, model.nbody):
        distance = float(np.linalg.norm(question.data.xipos[body]))
        if distance > _FAR and model.body_weldid[body]:
            told = f"{{}} is {distance:.2g} m from the origin: float32 cannot resolve it"
            yield of_one(model, "body", body, told, "move the scene to the origin, or use float64")


def tendons_without_direction(question: Question) -> Iterator[Spoiler]:
    """Spatial tendons with two sites in one place, but for springs alone that are at rest there."""
    model, data = question.model, question.data
    loads = (model.tendon_limited, model.tendon_damping, model.tendon_frictionloss, model.tendon_armature)
    is_loaded = np.any([some != 0 for some in loads], axis=0)
    is_loaded[model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0]] = True
    for i in range(model.ntendon):
        wraps = model.tendon_adr[i] + np.arange(model.tendon_num[i])
        is_site = model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_SITE
        if not is_site.any():
            continue
        places = data.site_xpos[np.where(is_site, model.wrap_objid[wraps], 0)]
        meets = (np.linalg.norm(np.diff(places, axis=0), axis=1) <= _COINCIDE) & is_site[1:] & is_site[:-1]
        has_spring = model.tendon_stiffness[i] > 0
        is_plain = len(wraps) == 2 and (not has_spring or model.tendon_lengthspring[i, 1] == 0)
        if meets.any() and (is_loaded[i] or (has_spring and not is_plain)):
            told = "{}: two of its sites are in one place, where it has no direction"
            yield of_one(model, "tendon", i, told, "start with the sites apart", AGREEMENT)


def clamped_tendons(question: Question) -> Iterator[Spoiler]:
    """MJX divides by the force that it clamps, zero or not."""
    model, data = question.model, question.data
    pulls = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    for i in np.flatnonzero(model.tendon_actfrclimited).tolist():
        if data.actuator_force[pulls & (model.actuator_trnid[:, 0] == i)].sum() == 0:
            told = "actuatorfrcrange of {}: reverse mode is NaN where its actuators pull with no force"
            yield of_one(model, "tendon", i, told, "give each actuator a forcerange instead", "reverse mode")


def drifting_equalities(question: Question) -> Iterator[Spoiler]:
    """Joints made of equalities, in rotation."""
    model = question.model
    if model.opt.disableflags & (mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return
    for kind, name in ((mujoco.mjtEq.mjEQ_CONNECT, "connect"), (mujoco.mjtEq.mjEQ_WELD, "weld")):
        for i in np.flatnonzero(model.eq_type == kind).tolist():
            what = f"<{name}> {name_of(model, 'equality', i)}: MJX leaves out the part of its reference acceleration"
            what += " that grows with the square of the angular speed"
            yield Spoiler(Culprit(what, (("equality", i),)), EQUALITY_REMEDY, measured_by="parity")


def _geoms(geoms: tuple[int, int]) -> tuple[tuple[str, int], ...]:
    return tuple(("geom", geom) for geom in geoms)


OF_MJX = (
    native, passive_flags, collisions, large_meshes, contact_limits, upright_capsules, differences_from_c,
    clamped_tendons, drifting_equalities, far_away,
)  # fmt: skip
"""Of what only MJX does, or only float32."""
DETECTORS = (solver, tendons_without_direction)
