"""What MJX's JAX implementation cannot simulate, told with the name of the element that asks for it.

`mjx.put_model` is the authority on what is supported; it names the feature but not the element. This finds the element.
"""

import itertools
from collections.abc import Iterator
from pathlib import Path

import mujoco

from tog_mjx._mjx import mjx
from tog_mjx.errors import InputError

# (elements, field of the model, what MJX supports, MuJoCo's own enumeration, remedy)
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
    try:
        mjx.put_model(model, impl="jax")
    except (NotImplementedError, ValueError) as error:
        reason = " ".join(str(error).split())
        culprits = [
            *_unsupported_options(model),
            *_unsupported_elements(model),
            *_unsupported_collisions(model, reason),
        ]
        what = "; ".join(culprits) or reason
        raise InputError(f"{path}: MJX does not support {what}; remove or replace it") from None


def _label(enumeration, value) -> str:
    """`implicit` of mjtIntegrator.mjINT_IMPLICIT."""
    return enumeration(int(value)).name.split("_", 1)[1].lower()


def _unsupported_options(model: mujoco.MjModel) -> Iterator[str]:
    for name, supported, enumeration in _OPTIONS:
        value = int(getattr(model.opt, name))
        if value not in set(supported):
            yield f"<option {name}={_label(enumeration, value)!r}>"


def _unsupported_elements(model: mujoco.MjModel) -> Iterator[str]:
    for kind, field, supported, enumeration in _TYPED_ELEMENTS:
        for i, value in enumerate(getattr(model, field)):
            if value not in set(supported):
                name = getattr(model, kind)(i).name or repr(i)
                yield f"{kind} {name} ({field.split('_')[1]} {_label(enumeration, value)})"
    for i in range(model.nflex):
        yield f"flex {model.flex(i).name or i!r}"


def _unsupported_collisions(model: mujoco.MjModel, reason: str) -> Iterator[str]:
    """The first geoms that can meet and whose types are those of MJX's message `(type, type) collisions ...`."""
    if "collisions not implemented" not in reason:
        return
    explicit = zip(model.pair_geom1, model.pair_geom2, strict=True)
    dynamic = (pair for pair in itertools.combinations(range(model.ngeom), 2) if _may_collide(model, *pair))
    for geom1, geom2 in itertools.chain(explicit, dynamic):
        types = [mujoco.mjtGeom(int(model.geom_type[g])) for g in (geom1, geom2)]
        if all(t.name in reason for t in types):
            names = [
                f"geom {model.geom(int(g)).name or int(g)!r} ({_label(mujoco.mjtGeom, t)})"
                for g, t in zip((geom1, geom2), types, strict=True)
            ]
            yield f"the collision of {names[0]} with {names[1]}"
            return


def _may_collide(model: mujoco.MjModel, geom1: int, geom2: int) -> bool:
    mask = model.geom_contype[geom1] & model.geom_conaffinity[geom2]
    mask |= model.geom_contype[geom2] & model.geom_conaffinity[geom1]
    return bool(mask and model.geom_bodyid[geom1] != model.geom_bodyid[geom2])
