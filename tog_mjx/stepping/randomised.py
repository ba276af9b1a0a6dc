"""Batches of models: one `mjx.Model` in which some fields, or all, have a leading axis.

That is what domain randomisation makes, by `model.tree_replace` or by `jax.vmap`. MJX has no word for it: the shapes
alone tell.
"""

import functools
from typing import Any

import jax
import mujoco
import numpy as np

from tog_mjx.running.errors import InputError
from tog_mjx.stepping._mjx import mjx

_RANKS = {"cam_mat0": 3}
"""Where MJX's is another than C MuJoCo's."""
_UNKNOWN = 99


def batched_fields(model: mjx.Model) -> dict[str, tuple[int, ...]]:
    """The fields with more axes than a field of one model has, and their shapes."""
    leaves = jax.tree_util.tree_leaves_with_path(model)
    return {_name(path): np.shape(leaf) for path, leaf in leaves if np.ndim(leaf) > _rank(_name(path))}


def in_axes(model: mjx.Model) -> Any:
    """The model's axes for `jax.vmap`: 0 for its batched fields, None for the others; None if it is no batch."""
    batched = batched_fields(model)
    if not batched:
        return None
    leaves, tree = jax.tree_util.tree_flatten_with_path(model)
    names = [_name(path) for path, _ in leaves]
    # What only MJX has is of a batch where all else is: the model has come out of `jax.vmap`.
    others = 0 if all(name in batched for name in names if _rank(name) < _UNKNOWN) else None
    axes = [0 if name in batched else None if _rank(name) < _UNKNOWN else others for name in names]
    return jax.tree.unflatten(tree, axes)


def require_one(model: mjx.Model) -> None:
    """Raises InputError for a batch of models."""
    remedy = "take them one by one with jax.vmap, or give tog.simulate a batch of data as well"
    for name, shape in batched_fields(model).items():
        raise InputError(f"{name} of the model has the shape {list(shape)}: it is a batch of models; {remedy}")


def _name(path: tuple) -> str:
    return jax.tree_util.keystr(path).lstrip(".")


@functools.cache
def _rank(name: str) -> int:
    """The number of axes of a field of one model; that of what only MJX has is not known."""
    if name in _RANKS:
        return _RANKS[name]
    found: Any = _empty()
    for part in name.split("."):
        found = found if part == "_impl" else getattr(found, part, None)
    return _UNKNOWN if found is None else np.ndim(found)


@functools.cache
def _empty() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string("<mujoco/>")
