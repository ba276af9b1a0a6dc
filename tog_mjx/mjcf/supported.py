"""What MJX's JAX implementation cannot simulate, or would ignore in silence, told with the name of the element.

`mjx.put_model` and `mjx.make_data` are the authority on what is supported, but they stop at the first feature and do
not name the element, and some features fail only in `mjx.step`. This finds them all, without compiling anything.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import mujoco
import numpy as np

from tog_mjx.mjcf.pairs import geom_pairs
from tog_mjx.running.errors import InputError
from tog_mjx.stepping._mjx import has_collision_fn, make_data, mjx, put_model

# Elements, the field of the model with their type, the enumeration of what MJX supports of it, and MuJoCo's own.
_TYPED_ELEMENTS = (
    ("actuator", "actuator_trntype", "TrnType", mujoco.mjtTrn),
    ("actuator", "actuator_dyntype", "DynType", mujoco.mjtDyn),
    ("actuator", "actuator_gaintype", "GainType", mujoco.mjtGain),
    ("actuator", "actuator_biastype", "BiasType", mujoco.mjtBias),
    ("equality", "eq_type", "EqType", mujoco.mjtEq),
    ("sensor", "sensor_type", "SensorType", mujoco.mjtSensor),
)
_MARGINLESS = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)
_IGNORED = (
    ("actuator", "actuator_delay", "the delay"),
    ("actuator", "actuator_damping", "the damping"),
    ("actuator", "actuator_dampingpoly", "the damping"),
    ("actuator", "actuator_armature", "the armature"),
    ("joint", "jnt_stiffnesspoly", "the higher powers of the stiffness"),
    ("joint", "jnt_springyield", "the springyield"),
    ("joint", "dof_dampingpoly", "the higher powers of the damping"),
    ("tendon", "tendon_stiffnesspoly", "the higher powers of the stiffness"),
    ("tendon", "tendon_dampingpoly", "the higher powers of the damping"),
    ("tendon", "tendon_springyield", "the springyield"),
    ("geom", "geom_surfacevel", "the surfacevel"),
    ("geom", "geom_adhesion", "the adhesion"),
    ("pair", "pair_adhesion", "the adhesion"),
)
"""Elements, and fields of the model that MJX does not read: what it ignores where they are not zero."""


class Culprit(NamedTuple):
    """What is wrong, and the elements of which: (kind, number); of an option, the name of its attribute alone."""

    what: str
    elements: tuple[tuple[str, int], ...] = ()
    attribute: str = ""


def check_supported(model: mujoco.MjModel, path: str | Path) -> None:
    """Raises InputError, one line naming elements and features, if MJX cannot simulate `model`, read from `path`."""
    if found := list(unsupported(model)):
        raise InputError(f"{path}: MJX does not support {_listed(found)}; remove or replace it")
    if found := list(ignored(model)):
        raise InputError(f"{path}: MJX ignores {_listed(found)}, so the motion would be another one; remove it")
    try:
        make_data(put_model(model))
    except (NotImplementedError, ValueError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise InputError(f"{path}: MJX does not support {reason}; remove or replace it") from None


def unsupported(model: mujoco.MjModel) -> Iterator[Culprit]:
    """What MJX refuses, in `mjx.put_model`, `mjx.make_data` or `mjx.step`."""
    yield from _options(model)
    yield from _elements(model)
    yield from _collisions(model)


def ignored(model: mujoco.MjModel) -> Iterator[Culprit]:
    """What MJX takes without a word and does not simulate."""
    for i in range(model.nplugin):
        yield Culprit(f"plugin {name_of(model, 'plugin', i)}")
    for i in np.flatnonzero(model.actuator_plugin >= 0).tolist():
        yield Culprit(f"the plugin of actuator {name_of(model, 'actuator', i)}", (("actuator", i),))
    for kind, field, what in _IGNORED:
        values = getattr(model, field)
        given = values.any(axis=tuple(range(1, values.ndim)))
        numbers = model.dof_jntid[given] if field.startswith("dof_") else np.flatnonzero(given)
        for i in sorted({int(number) for number in numbers}):
            yield Culprit(f"{what} of {kind} {name_of(model, kind, i)}", ((kind, i),))
    for i in np.flatnonzero(model.geom_fluid[:, 0] * has_fluid(model)).tolist():
        yield Culprit(f"fluidshape='ellipsoid' of geom {name_of(model, 'geom', i)}", (("geom", i),))
    if model.opt.noslip_iterations:
        yield Culprit(f"<option noslip_iterations='{model.opt.noslip_iterations}'>", attribute="noslip_iterations")
    if model.opt.disableactuator:
        yield Culprit("<option actuatorgroupdisable>", attribute="actuatorgroupdisable")


def name_of(model: mujoco.MjModel, kind: str, i: int) -> str:
    """An element's name; without one its number, for a geom or a joint in its body."""
    objects = {"plugin": mujoco.mjtObj.mjOBJ_PLUGIN, "flex": mujoco.mjtObj.mjOBJ_FLEX}
    name = mujoco.mj_id2name(model, objects[kind], i) if kind in objects else getattr(model, kind)(i).name
    if name or kind not in ("geom", "joint"):
        return name or f"number {i}"
    body = int((model.geom_bodyid if kind == "geom" else model.jnt_bodyid)[i])
    return f"number {i} (of body {name_of(model, 'body', body)})"


def geoms_named(model: mujoco.MjModel, geoms: Iterable[int], between: str = " and ") -> str:
    return between.join(f"geom {name_of(model, 'geom', geom)}" for geom in geoms)


def type_of(model: mujoco.MjModel, geom: int) -> str:
    """`cylinder`."""
    return _label(mujoco.mjtGeom, model.geom_type[geom])


def has_fluid(model: mujoco.MjModel) -> bool:
    """Whether there is a medium."""
    return bool(model.opt.density > 0 or model.opt.viscosity > 0 or model.opt.wind.any())


def candidates(model: mujoco.MjModel) -> list[tuple[int, int, int]]:
    """The geoms that MJX collides, ordered by their types, and the number of their <pair>, -1 without one."""
    off = mujoco.mjtDisableBit
    return [] if model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT) else geom_pairs(model)


def has_constraints(model: mujoco.MjModel) -> bool:
    """Whether the solver can have anything to do."""
    return bool(candidates(model)) or _has_other_rows(model)


def _listed(found: list[Culprit]) -> str:
    return "; ".join(culprit.what for culprit in found)


def _label(enumeration, value) -> str:
    """`implicit` of mjtIntegrator.mjINT_IMPLICIT."""
    return enumeration(int(value)).name.split("_", 1)[1].lower()


def _options(model: mujoco.MjModel) -> Iterator[Culprit]:
    # `mjx.put_model` takes the integrator discrete too, but `mjx.step` does not.
    integrators = (mjx.IntegratorType.EULER, mjx.IntegratorType.RK4, mjx.IntegratorType.IMPLICITFAST)
    options = (
        ("integrator", integrators, mujoco.mjtIntegrator),
        ("cone", mjx.ConeType, mujoco.mjtCone),
        ("solver", mjx.SolverType, mujoco.mjtSolver),
    )
    for name, supported, enumeration in options:
        value = int(getattr(model.opt, name))
        if value not in set(supported):
            yield Culprit(f"<option {name}={_label(enumeration, value)!r}>", attribute=name)
    for bit in range(int(mujoco.mjtEnableBit.mjNENABLE)):
        if model.opt.enableflags & 2**bit and 2**bit not in set(mjx.EnableBit):
            name = _label(mujoco.mjtEnableBit, 2**bit)
            yield Culprit(f"<flag {name}='enable'>", attribute=name)
    if model.opt.integrator == mjx.IntegratorType.IMPLICITFAST and has_fluid(model):
        yield Culprit("<option integrator='implicitfast'> with a density, viscosity or wind", attribute="integrator")
    is_elliptic = model.opt.cone == mjx.ConeType.ELLIPTIC and not model.opt.disableflags & mjx.DisableBit.CONTACT
    if is_elliptic and _has_other_rows(model) and not candidates(model):
        # Stock MJX indexes an empty array there.
        yield Culprit("<option cone='elliptic'> with constraints but no geoms that can meet", attribute="cone")


def _has_other_rows(model: mujoco.MjModel) -> bool:
    """Whether there are constraints other than contacts, which are computed beside them."""
    off = mujoco.mjtDisableBit
    rows = (
        (off.mjDSBL_EQUALITY, model.neq),
        (off.mjDSBL_FRICTIONLOSS, (model.dof_frictionloss > 0).any() or (model.tendon_frictionloss > 0).any()),
        (off.mjDSBL_LIMIT, model.jnt_limited.any() or model.tendon_limited.any()),
    )
    if model.opt.disableflags & off.mjDSBL_CONSTRAINT:
        return False
    return any(bool(given) and not model.opt.disableflags & flag for flag, given in rows)


def _elements(model: mujoco.MjModel) -> Iterator[Culprit]:
    for kind, field, supported, enumeration in _TYPED_ELEMENTS:
        for i, value in enumerate(getattr(model, field)):
            if value not in set(getattr(mjx, supported)):
                described = f"{field.split('_')[1]} {_label(enumeration, value)}"
                yield Culprit(f"{kind} {name_of(model, kind, i)} ({described})", ((kind, i),))
    for i in range(model.nflex):
        yield Culprit(f"flex {name_of(model, 'flex', i)}")
    for i in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT).tolist():
        if reason := _refused_contact_sensor(model, i):
            yield Culprit(f"sensor {name_of(model, 'sensor', i)} ({reason})", (("sensor", i),))
    yield from _sensors_of_nothing(model)


def _sensors_of_nothing(model: mujoco.MjModel) -> Iterator[Culprit]:
    """Sensors for which stock MJX reads an empty array: what they look at must be there."""
    if model.opt.disableflags & mjx.DisableBit.SENSOR:
        return
    kinds = mujoco.mjtSensor
    sees_no_contact = _has_other_rows(model) and not candidates(model)
    for i, kind in enumerate(model.sensor_type):
        if kind == kinds.mjSENS_RANGEFINDER and not model.nmat:
            why = "a rangefinder in a scene without any <material>"
        elif sees_no_contact and (kind == kinds.mjSENS_TOUCH or _reads_forces(model, i)):
            why = "of contact forces, with constraints but no geoms that can meet"
        else:
            continue
        yield Culprit(f"sensor {name_of(model, 'sensor', i)} ({why})", (("sensor", i),))


def _reads_forces(model: mujoco.MjModel, i: int) -> bool:
    """Whether a sensor is one of contacts that asks for forces or torques, or for the contact of the largest force."""
    data, reduction = model.sensor_intprm[i, :2].tolist()
    return bool(model.sensor_type[i] == mujoco.mjtSensor.mjSENS_CONTACT and (data & 0b110 or reduction == 2))


def step_failure(model: mujoco.MjModel) -> str:
    """What stock MJX says of a scene that it cannot step, though `unsupported` knows nothing of it; empty if it can."""
    try:
        jax.eval_shape(mjx.step, put_model(model), make_data(model))
    except Exception as error:  # It fails in whatever way its arrays make it fail.
        return f"{type(error).__name__}: {str(error).strip().splitlines()[0] if str(error).strip() else ''}"
    return ""


def _refused_contact_sensor(model: mujoco.MjModel, i: int) -> str:
    kinds = {int(model.sensor_objtype[i]), int(model.sensor_reftype[i])}
    if int(model.sensor_objtype[i]) == mujoco.mjtObj.mjOBJ_SITE:
        return "a contact sensor that matches by site"
    if kinds & {int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY)}:
        return "a contact sensor that matches by body or subtree"
    is_net = model.sensor_intprm[i, 1] == 3
    return "a contact sensor that reduces to a net force" if is_net else ""


def _collisions(model: mujoco.MjModel) -> Iterator[Culprit]:
    """Pairs of geoms that MJX does not collide, or not so: each kind of them once, with the geoms of the first."""
    found: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
    for first, second, pair in geom_pairs(model):
        if what := _refused(model, first, second, pair):
            key = what, type_of(model, first), type_of(model, second)
            found.setdefault(key, []).append((first, second))
    for (what, *types), pairs in found.items():
        names = [f"geom {name_of(model, 'geom', geom)} ({kind})" for geom, kind in zip(pairs[0], types, strict=True)]
        more = f" and {len(pairs) - 1} more such pairs" if len(pairs) > 1 else ""
        yield Culprit(f"{what} of {names[0]} with {names[1]}{more}", tuple(("geom", geom) for geom in pairs[0]))


def _refused(model: mujoco.MjModel, first: int, second: int, pair: int) -> str:
    """What of the collision of two geoms MJX refuses; empty if nothing."""
    types = model.geom_type[[first, second]].tolist()
    if not has_collision_fn(*types):
        return "the collision"
    margin = model.pair_margin[pair] if pair >= 0 else model.geom_margin[[first, second]].sum()
    if margin and any(kind in _MARGINLESS for kind in types):
        return "the margin or gap"
    if model.opt.cone == mjx.ConeType.ELLIPTIC and _condim(model, first, second, pair) == 1:
        return "condim='1' on the elliptic cone, for the contact"
    return ""


def _condim(model: mujoco.MjModel, first: int, second: int, pair: int) -> int:
    """The dimension of a contact of two geoms: the pair's, the one of higher priority's, else the larger."""
    if pair >= 0:
        return int(model.pair_dim[pair])
    geoms = np.array([first, second])
    priorities = model.geom_priority[geoms]
    return int(model.geom_condim[geoms[priorities == priorities.max()]].max())
