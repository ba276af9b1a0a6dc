"""What a function is given: a vector, or any pytree of arrays, taken as one vector whose numbers have names."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tog_mjx.running.errors import InputError
from tog_mjx.running.types import AnyArray

_REMEDY = "give a vector of finite numbers, or a pytree of arrays of them"


@dataclass(frozen=True, eq=False)
class Variables:
    """A point [n]; `shapes` are those of its leaves by name, in the order of the vector."""

    point: Float[np.ndarray, " n"]
    shapes: Mapping[str, tuple[int, ...]]
    tree: Any

    @property
    def names(self) -> tuple[str, ...]:
        """Of all numbers: `x[0]`, `x['w'][0, 1]`."""
        numbers = ((leaf, i) for leaf, shape in self.shapes.items() for i in np.ndindex(shape))
        return tuple(f"{leaf}[{', '.join(map(str, i))}]" if i else leaf for leaf, i in numbers)

    @property
    def parts(self) -> dict[str, slice]:
        """Where the numbers of each leaf are that has any."""
        sizes = {leaf: math.prod(shape) for leaf, shape in self.shapes.items()}
        ends = np.cumsum([*sizes.values()]).tolist()
        return {leaf: slice(end - size, end) for (leaf, size), end in zip(sizes.items(), ends, strict=True) if size}

    def restore(self, x: Float[AnyArray, "*batch n"]) -> Any:
        """The pytree of a vector; of a batch of them, with its axes before those of each leaf."""
        parts = {leaf: x[..., part] for leaf, part in self.parts.items()}
        leaves = [parts.get(leaf, x[..., :0]).reshape(*x.shape[:-1], *shape) for leaf, shape in self.shapes.items()]
        return jax.tree.unflatten(self.tree, leaves)


def variables(x: Any, name: str = "x") -> Variables:
    """A list of numbers is a vector too.

    Raises:
      InputError: for what holds no numbers, or others than finite real ones.
    """
    if type(x) in (list, tuple) and all(isinstance(number, Real) for number in x):
        x = np.array(x)
    leaves, tree = jax.tree_util.tree_flatten_with_path(x)
    named = {f"{name}{jax.tree_util.keystr(path)}": leaf for path, leaf in leaves}
    found = {name: _finite(name, leaf) for name, leaf in named.items()}
    if not any(leaf.size for leaf in found.values()):
        raise InputError(f"{name} holds no numbers: {_REMEDY}")
    point = np.concatenate([leaf.ravel() for leaf in found.values()])
    return Variables(point, {leaf: array.shape for leaf, array in found.items()}, tree)


def _finite(name: str, leaf: Any) -> np.ndarray:
    try:
        array = np.asarray(leaf)
    except (TypeError, ValueError):
        array = np.array(None)
    kinds = np.bool, np.integer, np.floating
    if not any(jnp.issubdtype(array.dtype, kind) for kind in kinds):
        raise InputError(f"{name} is of type {getattr(leaf, 'dtype', type(leaf).__name__)}: {_REMEDY}")
    array = array.astype(float)
    if not np.isfinite(array).all():
        raise InputError(f"{name} is not finite: {_REMEDY}")
    return array
