"""What follows from a number of a model: the compiler derives inertias from sizes and densities, and inverse weights,
by which constraints are scaled, from inertias. All of it to first order, by central differences of MuJoCo's own work.

Two roads. In an `MjSpec` the MJCF attribute itself is changed, and compiled again: all that the compiler derives moves.
Of a compiled model alone `mj_setConst` derives the inverse weights; inertias stay, as a model knows no densities.
"""

import copy
import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float, Int

from tog_mjx.mjcf.fields import attribute
from tog_mjx.running.errors import InputError
from tog_mjx.running.quiet import without_warnings
from tog_mjx.stepping._mjx import float_fields

Arrays = dict[str, np.ndarray]
Origin: TypeAlias = str | Path | mujoco.MjSpec
"""What a model was compiled from: an MJCF file, or its MjSpec."""
LEADERS = frozenset(
    {
        *("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat", "geom_size", "geom_pos"),
        *("geom_quat", "site_pos", "site_quat", "jnt_pos", "jnt_axis", "qpos0", "dof_armature", "tendon_armature"),
        *("actuator_gear", "actuator_cranklength", "actuator_gainprm"),
    }
)
"""Arrays from which others follow."""
_OF_GEOMS = ("body_mass", "body_inertia", "body_ipos", "body_iquat")
_SIZES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_CYLINDER: 2,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: 3, mujoco.mjtGeom.mjGEOM_BOX: 3,
}  # fmt: skip
"""How many numbers of a geom's size make its mass."""
_STEP = 1e-5
"""Of the number itself, or of 1 where it is zero: the errors of differences are about 1e-10, the square of it and the
share of rounding in it."""
_SAME, _NOTHING = 1e-6, 1e-9
"""Relative differences that count as none: from what was asked for, and from no motion at all."""
_TENSOR = "inertia tensor"
"""In place of principal axes, which may be swapped, and are not unique, where it is smooth."""


class Followers(NamedTuple):
    """`rates`: by array, the derivative [size, n] of all its numbers in the n asked for; of the asked array itself only
    where those do not move alone, as in a quaternion, which stays one. `behind`: the arrays that should move, and do
    not, as it is not known by how much."""

    rates: dict[str, Float[np.ndarray, "size n"]]
    behind: tuple[str, ...] = ()


def followers(
    model: mujoco.MjModel, array: str, chosen: Int[np.ndarray, " n"], spec: mujoco.MjSpec | None = None
) -> Followers:
    """Of the numbers `chosen` of an array of `mjx.Model`; `spec` is what the model was compiled from, if known."""
    rates: Arrays = {}
    behind: set[str] = set()
    if _is_quaternion(array):
        rates[array] = np.stack([_own(model, array, entry) for entry in chosen.tolist()], axis=1)
    with without_warnings():
        for column, entry in enumerate(chosen.tolist() if array in LEADERS else ()):
            found = _column(model, array, entry, functools.partial(_compiled, spec, model, array, entry))
            if found is None:
                behind |= {name for name in _missed(model, array, entry) if name != array}
                found = _column(model, array, entry, functools.partial(_derived, model, array, entry)) or {}
            if _TENSOR in found:
                found["body_inertia"], found["body_iquat"], is_lost = _principal(model, found.pop(_TENSOR))
                behind |= {"body_iquat"} if is_lost else set()
            for name, rate in found.items():
                if name != array and rate.any():
                    rates.setdefault(name, np.zeros((rate.size, len(chosen))))[:, column] = rate
    return Followers(rates, tuple(sorted(behind)))


def compiled(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjSpec]:
    """The model, and a copy of the spec, which alone is written to.

    Raises:
      InputError: for what MuJoCo does not compile.
    """
    spec = spec.copy()
    try:
        with without_warnings():
            return spec.compile(), spec
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"the MjSpec does not compile: {' '.join(str(error).split())}") from None


def spec_of(model: mujoco.MjModel, origin: Origin | None) -> mujoco.MjSpec | None:
    """What the model was compiled from, if that is the origin and the model has not been changed since."""
    if origin is None:
        return None
    try:
        with without_warnings():
            spec = origin.copy() if isinstance(origin, mujoco.MjSpec) else mujoco.MjSpec.from_file(str(origin))
            expected, given = _arrays(spec.compile()), _arrays(model)
    except (ValueError, OSError, mujoco.FatalError):
        return None
    is_same = expected.keys() == given.keys() and all(
        given[name].shape == value.shape and np.allclose(given[name], value, rtol=_SAME)
        for name, value in expected.items()
    )
    return spec if is_same else None


def _arrays(model: mujoco.MjModel) -> Arrays:
    """All arrays of floats of the model that MJX has too, but for lights."""
    names = [name for name in float_fields() if "." not in name and not name.startswith("light_")]
    found = {name: np.array(getattr(model, name, 0)) for name in names}
    return {name: value for name, value in found.items() if value.dtype.kind == "f" and value.size}


def _own(model: mujoco.MjModel, array: str, entry: int) -> Float[np.ndarray, " size"]:
    """How an array moves with a number of itself."""
    value = attribute(model, array)
    unit = np.zeros(value.size)
    unit[entry] = 1.0
    if _is_quaternion(array):
        first = entry // 4 * 4
        quaternion = value.ravel()[first : first + 4]
        unit[first : first + 4] -= quaternion * quaternion[entry - first]
    return unit


def _is_quaternion(array: str) -> bool:
    return array.endswith("quat")


def _column(
    model: mujoco.MjModel, array: str, entry: int, displaced: Callable[[float], Arrays | None]
) -> Arrays | None:
    """The derivatives of all arrays in one number, by what is `displaced` by so much; None where it cannot be, moves
    otherwise than asked, or jumps."""
    size = abs(float(attribute(model, array).ravel()[entry])) or 1.0
    h, start = _STEP * size, _arrays(model)
    ahead, behind = displaced(h), displaced(-h)
    if ahead is None or behind is None:
        return None
    if array not in ("body_inertia", "body_iquat"):
        for arrays in (start, ahead, behind):
            arrays[_TENSOR] = _tensors(arrays.pop("body_inertia"), arrays.pop("body_iquat"))
    rates = {}
    for name, value in start.items():
        reach = np.abs(value).max()
        if np.abs((ahead[name] + behind[name]) / 2 - value).max() > _SAME * reach:
            return None
        rate = (ahead[name] - behind[name]) / (2 * h)
        rates[name] = np.where(np.abs(rate) * size > _NOTHING * reach, rate, 0.0).ravel()
    if not rates[array].any():
        return {}  # As the second size of a sphere: it is no number of the scene.
    return rates if np.allclose(rates[array], _own(model, array, entry), atol=_SAME) else None


def _compiled(spec: mujoco.MjSpec | None, model: mujoco.MjModel, array: str, entry: int, h: float) -> Arrays | None:
    if spec is None:
        return None
    changed = spec.copy()
    if not _change(changed, model, array, entry, h):
        return None
    try:
        return _arrays(changed.compile())
    except (ValueError, mujoco.FatalError):
        return None


def _derived(model: mujoco.MjModel, array: str, entry: int, h: float) -> Arrays | None:
    changed = copy.copy(model)
    value = attribute(changed, array)
    value[...] += h * _own(model, array, entry).reshape(value.shape)
    if feedback := _feedback(model, array, entry):
        changed.actuator_biasprm[feedback] -= h
    try:
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
    except (mujoco.FatalError, ValueError):
        return None
    return _arrays(changed)


def _change(spec: mujoco.MjSpec, model: mujoco.MjModel, array: str, entry: int, h: float) -> bool:
    """Adds h to the attribute that a number of the model is compiled from; False where there is none."""
    kind, _, name = array.partition("_")
    i, *rest = (int(k) for k in np.unravel_index(entry, attribute(model, array).shape))
    if array == "dof_armature":
        kind, i = "jnt", int(model.dof_jntid[i])
        if model.jnt_type[i] < int(mujoco.mjtJoint.mjJNT_SLIDE):  # One attribute of several degrees of freedom.
            return False
    every = {"body": "bodies", "geom": "geoms", "jnt": "joints", "site": "sites", "tendon": "tendons"}
    elements = getattr(spec, {**every, "actuator": "actuators"}.get(kind, ""), ())
    element = next((some for some in elements if some.id == i), None)
    if element is None:
        return False
    if array in _OF_GEOMS:
        is_given = element.explicitinertial and spec.compiler.inertiafromgeom != 1  # 1: geoms overrule it.
        if not is_given:
            return array == "body_mass" and _change_densities(spec, model, i, h)
    if kind == "geom" and not np.isnan(element.fromto[0]):
        element.fromto[0] = np.nan
        element.pos, element.quat, element.size = model.geom_pos[i], model.geom_quat[i], model.geom_size[i]
    if name == "quat":
        element.alt.type, element.quat = mujoco.mjtOrientation.mjORIENTATION_QUAT, attribute(model, array)[i]
    if feedback := _feedback(model, array, entry):
        element.biasprm[feedback[1]] -= h
    if rest:
        getattr(element, name)[rest[0]] += h
    else:
        setattr(element, name, getattr(element, name) + h)
    return True


def _feedback(model: mujoco.MjModel, array: str, entry: int) -> tuple[int, int] | None:
    """Of a servo's gain, kp or kv in MJCF: the place in `actuator_biasprm` that is its negative."""
    i, k = divmod(entry, model.actuator_gainprm.shape[1])
    if array != "actuator_gainprm" or k or not model.actuator_gainprm[i, 0]:
        return None
    same = np.flatnonzero(model.actuator_biasprm[i, 1:3] == -model.actuator_gainprm[i, 0])
    return (i, 1 + int(same[0])) if len(same) else None


def _change_densities(spec: mujoco.MjSpec, model: mujoco.MjModel, body: int, h: float) -> bool:
    """Of all geoms of the body by the same factor."""
    if not model.body_mass[body]:
        return False
    factor = 1 + h / model.body_mass[body]
    for geom in spec.geoms:
        if geom.id >= 0 and model.geom_bodyid[geom.id] == body:
            geom.mass, geom.density = geom.mass * factor, geom.density * factor  # NaN stays: a mass not given.
    return True


def _missed(model: mujoco.MjModel, array: str, entry: int) -> tuple[str, ...]:
    """What follows by the compiler alone."""
    if array not in ("body_mass", "geom_size", "geom_pos", "geom_quat"):
        return ()
    i, *rest = np.unravel_index(entry, attribute(model, array).shape)
    body = i if array == "body_mass" else model.geom_bodyid[i]
    is_read = array != "geom_size" or rest[0] < _SIZES.get(mujoco.mjtGeom(model.geom_type[i]), 0)
    if not model.body_weldid[body] or not is_read:
        return ()
    return ("body_inertia",) if array == "body_mass" else _OF_GEOMS


def _tensors(inertia: Float[np.ndarray, "b 3"], iquat: Float[np.ndarray, "b 4"]) -> Float[np.ndarray, "b 3 3"]:
    """In the frames of the bodies."""
    rotations = _rotations(iquat)
    return (rotations * inertia[:, None, :]) @ rotations.swapaxes(1, 2)


def _rotations(quaternions: Float[np.ndarray, "b 4"]) -> Float[np.ndarray, "b 3 3"]:
    found = np.zeros((len(quaternions), 9))
    for row, quaternion in zip(found, quaternions, strict=True):
        mujoco.mju_quat2Mat(row, quaternion)
    return found.reshape(-1, 3, 3)


def _principal(model: mujoco.MjModel, rate: Float[np.ndarray, " nbody_9"]) -> tuple[np.ndarray, np.ndarray, bool]:
    """The rates of `body_inertia` and `body_iquat`, and whether some of it is lost: axes of equal moments have no
    direction that could turn."""
    rotations = _rotations(model.body_iquat)
    rate = rotations.swapaxes(1, 2) @ rate.reshape(-1, 3, 3) @ rotations
    rate[np.abs(rate) <= _NOTHING * np.abs(rate).max(axis=(1, 2), keepdims=True)] = 0.0
    moments = model.body_inertia
    turn, is_lost = np.zeros((model.nbody, 3)), False
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        apart = moments[:, i] - moments[:, j]
        is_equal = np.abs(apart) <= _SAME * np.abs(moments).max(axis=1)
        turn[:, axis] = np.where(is_equal, 0.0, rate[:, i, j] / np.where(is_equal, 1.0, apart))
        is_lost |= bool((is_equal & (np.abs(rate[:, i, j]) > _SAME * np.abs(rate).max(axis=(1, 2)))).any())
    quaternions = np.zeros((model.nbody, 4))
    for row, quaternion, angle in zip(quaternions, model.body_iquat, turn, strict=True):
        mujoco.mju_mulQuat(row, quaternion, np.array([0.0, *angle]) / 2)
    return np.diagonal(rate, axis1=1, axis2=2).ravel(), quaternions.ravel(), is_lost
