"""What MJX's JAX implementation cannot simulate, or would ignore in silence, told with the name of the element.

`mjx.put_model` and `mjx.make_data` are the authority on what is supported; they name the feature but not the element.
This finds the element.
"""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from tog_mjx._mjx import make_data, mjx, put_model
from tog_mjx.errors import InputError

# Elements, the field of the model with their type, what MJX supports of it, and MuJoCo's own enumeration.
_TYPED_ELEMENTS = (
    ("actuator", "actuator_trntype", mjx.TrnType, mujoco.mjtTrn),
    ("actuator", "actuator_dyntype", mjx.DynType, mujoco.mjtDyn),
    ("actuator", "actuator_gaintype", mjx.GainType, mujoco.mjtGain),
    ("actuator", "actuator_biastype", mjx.BiasType, mujoco.mjtBias),
    ("equality", "eq_type", mjx.EqType, mujoco.mjtEq),
    ("sensor", "sensor_type", mjx.SensorType, mujoco.mjtSensor),
)
_OPTIONS = (
    ("integrator", mjx.IntegratorType, mujoco.mjtIntegrator),
    ("cone", mjx.ConeType, mujoco.mjtCone),
    ("solver", mjx.SolverType, mujoco.mjtSolver),
)


def check_supported(model: mujoco.MjModel, path: str | Path) -> None:
    """Raises InputError, one line naming element and feature, if MJX cannot simulate `model`, read from `path`."""
    if ignored := list(_ignored(model)):
        raise InputError(f"{path}: MJX ignores {'; '.join(ignored)}, so the motion would be another one; remove it")
    try:
        make_data(put_model(model))
    except (NotImplementedError, ValueError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        culprits = [*_options(model), *_elements(model), *_collisions(model, reason), *_others(model, reason)]
        detail = f"{'; '.join(culprits)}" if culprits else reason
        raise InputError(f"{path}: MJX does not support {detail}; remove or replace it") from None


def _label(enumeration, value) -> str:
    """`implicit` of mjtIntegrator.mjINT_IMPLICIT."""
    return enumeration(int(value)).name.split("_", 1)[1].lower()


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, i: int) -> str:
    return mujoco.mj_id2name(model, kind, i) or f"number {i}"


def _ignored(model: mujoco.MjModel) -> Iterator[str]:
    """What MJX takes without a word and does not simulate."""
    for i in range(model.nplugin):
        yield f"plugin {_name(model, mujoco.mjtObj.mjOBJ_PLUGIN, i)}"
    for i in np.flatnonzero(model.actuator_plugin >= 0).tolist():
        yield f"the plugin of actuator {_name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i)}"
    for i in np.flatnonzero(model.actuator_delay > 0).tolist():
        yield f"the delay of actuator {_name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i)}"
    if model.opt.noslip_iterations:
        yield f"<option noslip_iterations='{model.opt.noslip_iterations}'>"


def _options(model: mujoco.MjModel) -> Iterator[str]:
    for name, supported, enumeration in _OPTIONS:
        value = int(getattr(model.opt, name))
        if value not in set(supported):
            yield f"<option {name}={_label(enumeration, value)!r}>"
    for bit in range(int(mujoco.mjtEnableBit.mjNENABLE)):
        if model.opt.enableflags & 2**bit and 2**bit not in set(mjx.EnableBit):
            yield f"<flag {_label(mujoco.mjtEnableBit, 2**bit)}='enable'>"


def _elements(model: mujoco.MjModel) -> Iterator[str]:
    for kind, field, supported, enumeration in _TYPED_ELEMENTS:
        for i, value in enumerate(getattr(model, field)):
            if value not in set(supported):
                name = getattr(model, kind)(i).name or f"number {i}"
                yield f"{kind} {name} ({field.split('_')[1]} {_label(enumeration, value)})"
    for i in range(model.nflex):
        yield f"flex {_name(model, mujoco.mjtObj.mjOBJ_FLEX, i)}"


def _collisions(model: mujoco.MjModel, reason: str) -> Iterator[str]:
    """The first geoms that can meet and are of the two types in MJX's message `(type, type) ... not implemented`."""
    types = sorted(re.findall(r"mjGEOM_\w+", reason))
    if len(types) != 2:
        return
    what = "the margin or gap" if "margin" in reason else "the collision"
    explicit = zip(model.pair_geom1, model.pair_geom2, strict=True)
    dynamic = (pair for pair in itertools.combinations(range(model.ngeom), 2) if _may_collide(model, *pair))
    for pair in itertools.chain(explicit, dynamic):
        kinds = [mujoco.mjtGeom(int(model.geom_type[geom])) for geom in pair]
        if sorted(kind.name for kind in kinds) == types:
            names = [_name(model, mujoco.mjtObj.mjOBJ_GEOM, int(geom)) for geom in pair]
            described = [f"geom {n} ({_label(mujoco.mjtGeom, k)})" for n, k in zip(names, kinds, strict=True)]
            yield f"{what} of {described[0]} with {described[1]}"
            return


def _may_collide(model: mujoco.MjModel, geom1: int, geom2: int) -> bool:
    """MuJoCo's rules: matching masks, other bodies, and not a body with its parent unless that is the world."""
    mask = model.geom_contype[geom1] & model.geom_conaffinity[geom2]
    mask |= model.geom_contype[geom2] & model.geom_conaffinity[geom1]
    welds = [int(model.body_weldid[model.geom_bodyid[geom]]) for geom in (geom1, geom2)]
    parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    is_family = 0 not in welds and (welds[0] == parents[1] or welds[1] == parents[0])
    return bool(mask and welds[0] != welds[1] and not is_family)


def _others(model: mujoco.MjModel, reason: str) -> Iterator[str]:
    """Features whose message tells all but the name."""
    if "ontact sensor" in reason:
        for i in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT).tolist():
            yield f"sensor {_name(model, mujoco.mjtObj.mjOBJ_SENSOR, i)}: {reason}"
