"""The state in which a check begins: a keyframe's, the scene's own, or one from a file."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tog_mjx.running.errors import InputError
from tog_mjx.stepping.mjx_state import MOVING, default_start

_FIELDS = (*MOVING, "ctrl")


def keyframe_start(model: mujoco.MjModel, name: str | None = None) -> mujoco.MjData:
    """That of the keyframe; without a name that of `default_start`.

    Raises:
      InputError: with the names there are.
    """
    if name is None:
        return default_start(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    if key < 0:
        names = ", ".join(model.key(i).name or f"number {i}" for i in range(model.nkey)) or "none"
        raise InputError(f"the scene has no keyframe named {name}; its keyframes: {names}")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    return data


def saved_start(model: mujoco.MjModel, path: Path) -> mujoco.MjData:
    """That of a .npz or .json file with some of qpos, qvel, act and ctrl; the rest is that of `default_start`.

    Raises:
      InputError: for a file that cannot be read, or numbers that do not fit the model.
    """
    data = default_start(model)
    given = _read(path)
    if not set(given) & set(_FIELDS):
        raise InputError(f"{path}: it has none of {', '.join(_FIELDS)}; give at least one of them")
    for name in _FIELDS:
        if name not in given:
            continue
        field = getattr(data, name)
        try:
            value = np.asarray(given[name], float)
        except (TypeError, ValueError):
            raise InputError(f"{path}: {name} is not a list of numbers") from None
        if value.shape != field.shape or not np.isfinite(value).all():
            raise InputError(f"{path}: {name} has the shape {list(value.shape)}; give {len(field)} finite numbers")
        field[:] = value
    return data


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                return dict(file)
        given = json.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a .npz or .json file") from None
    except RecursionError:
        raise InputError(f"{path}: its lists are nested too deeply; give lists of numbers") from None
    except ValueError as error:  # Of both formats, and of text that is none.
        raise InputError(f"{path}: is no .npz or .json file: {error}") from None
    if not isinstance(given, dict):
        raise InputError(f"{path}: give an object with some of {', '.join(_FIELDS)}")
    return given
