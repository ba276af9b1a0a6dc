"""Arrays of floats of a model, by their names in `mjx.Model`, and which of their numbers a text like "body_mass[1]" or
"geom_friction[2, 0]" means."""

import math
import operator

import mujoco
import numpy as np
from jaxtyping import Int

from tog_mjx.running.errors import InputError, near
from tog_mjx.stepping._mjx import float_fields


def attribute(tree: object, path: str):
    """The value at a path with dots; AttributeError where there is none."""
    return operator.attrgetter(path)(tree)


def assign(model: mujoco.MjModel, path: str, value: np.ndarray | np.floating) -> None:
    """Writes to a field of MuJoCo's model; some of its options are plain numbers."""
    parent, _, name = path.rpartition(".")
    owner = attribute(model, parent) if parent else model
    setattr(owner, name, value if np.shape(value) else float(value))


def array_name(text: str) -> str:
    """The array's name in "name" or "name[1, 2]"."""
    return text.partition("[")[0]


def entries(text: str, shape: tuple[int, ...]) -> Int[np.ndarray, " k"]:
    """Which of the numbers of an array of that shape "name" (all) or "name[1, 2]" (a part) means.

    Raises:
      InputError: for an index that is not in the array.
    """
    every = np.arange(math.prod(shape), dtype=np.int32).reshape(shape)  # JAX adds no int64 where float64 is off.
    name, bracket, index = text.partition("[")
    if not bracket:
        return every.ravel()
    try:
        if not index.endswith("]"):
            raise ValueError("no bracket closes it")
        return np.atleast_1d(every[tuple(int(i) for i in index.removesuffix("]").split(","))]).ravel()
    except (ValueError, IndexError):
        raise InputError(f"{text!r}: {name} has the shape {list(shape)}; give {name} or an index in it") from None


def entry_names(name: str, shape: tuple[int, ...], chosen: Int[np.ndarray, " k"]) -> tuple[str, ...]:
    """The texts that mean one of those numbers each; of an array without axes its name."""
    indices = [", ".join(map(str, i)) for i in np.ndindex(shape)]
    return tuple(f"{name}[{indices[i]}]" if shape else name for i in chosen)


def field_of(model: mujoco.MjModel, name: str, others: tuple[str, ...] = ()) -> np.ndarray:
    """An array of floats of the model, by its name in `mjx.Model`.

    Raises:
      InputError: if there is none; `others` could have been meant too.
    """
    try:
        on_mjx, value = name in float_fields(), np.asarray(attribute(model, name))
    except AttributeError:
        on_mjx, value = False, np.zeros(0)
    if not on_mjx or value.dtype.kind != "f":
        listed = f"none of {', '.join(others)}, or" if others else "not"
        raise InputError(
            f"{name!r} is {listed} an array of numbers of mjx.Model; examples are geom_friction, body_mass, "
            f"opt.gravity{near(name, [*others, *float_fields()])}"
        )
    return value
