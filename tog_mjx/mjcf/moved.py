"""A model of C MuJoCo of which JAX moves numbers: to engine mujoco what `mjx.Model` is to MJX."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np
from jaxtyping import Array, Float, Int

from tog_mjx.mjcf.fields import attribute
from tog_mjx.running.errors import InputError
from tog_mjx.running.types import AnyArray
from tog_mjx.stepping._mjx import float_fields

Rates = dict[str, Float[np.ndarray, "size n"]]
"""By array, the derivative of all its numbers in those that move it."""
_OWN = frozenset({"body_subtreemass", "dof_M0", "geom_rbound", "geom_aabb"})
"""What C MuJoCo has at hand of other arrays, to be true of them exactly; MJX computes it as it goes, or does not."""
_READ, _WRITTEN = (set(getattr(mujoco.MjModel, f"_setconst_{which}")) for which in ("inputs", "outputs"))
"""By `mj_setConst`. MuJoCo tells to read these names, though they are private."""
_FRAMES = ("body_ipos", "body_iquat", "jnt_pos", "jnt_axis")
"""What may couple the joints of a body."""


@dataclass(frozen=True, eq=False)
class MovedModel:
    """Fields by their names in `mjx.Model`: those that were drawn, else the model's own, and what moves them, to first
    order: their `rates` times a `change` [n], whose large values are `size` [n]. All else is `model`'s."""

    model: mujoco.MjModel
    drawn: Mapping[str, Array]
    rates: Rates
    size: Float[np.ndarray, " n"]
    change: Float[AnyArray, " n"]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "MovedModel":
        """The model as it is."""
        return cls(model, {}, {}, np.zeros(0), np.zeros(0))  # Of NumPy: nothing is compiled.

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the fields that can be drawn."""
        found = {name: np.asarray(getattr(self.model, name)) for name in float_fields() if "." not in name}
        return {name: value.shape for name, value in found.items() if value.dtype.kind == "f"}

    def tree_replace(self, fields: Mapping[str, Array]) -> "MovedModel":
        """With other fields, in which nothing is differentiated; errors are those of `check_moves`."""
        for name in fields:
            check_moves(self.model, name)
        return MovedModel(self.model, {**self.drawn, **fields}, self.rates, self.size, self.change)

    def displaced(self, rates: Rates, size: Float[np.ndarray, " n"], change: Float[Array, " n"]) -> "MovedModel":
        """With more that moves it; errors are those of `check_moves`."""
        before, n = len(self.size), len(size)
        found = {name: np.pad(of, ((0, 0), (0, n))) for name, of in self.rates.items()}
        for name, of in rates.items():
            check_moves(self.model, name, np.flatnonzero(of.any(1)))
            found.setdefault(name, np.zeros((len(of), before + n)))[:, before:] = of
        joined = np.append(self.size, size), jnp.concatenate([self.change.astype(change.dtype), change])
        return MovedModel(self.model, self.drawn, found, *joined)

    def fields(self) -> dict[str, Array]:
        """All that moves, on JAX."""
        found = {}
        for name in {**self.drawn, **self.rates}:
            value = jnp.asarray(self.drawn.get(name, np.array(attribute(self.model, name))), self.change.dtype)
            if name in self.rates:
                value = value + (jnp.asarray(self.rates[name], value.dtype) @ self.change).reshape(value.shape)
            found[name] = value
        return found


def check_moves(model: mujoco.MjModel, name: str, chosen: Int[np.ndarray, " k"] | None = None) -> None:
    """Raises InputError where C MuJoCo does not move numbers `chosen` of a field, or all of it, of a compiled model."""
    if name not in mujoco.batch.MODEL_FIELDS:
        raise InputError(f"C MuJoCo cannot move {name} of one motion and not of others; take engine mjx")
    if name not in _FRAMES:
        return
    of_bodies = np.arange(model.nbody) if name.startswith("body") else model.jnt_bodyid
    rows = np.arange(len(of_bodies)) if chosen is None else chosen // getattr(model, name).shape[1]
    bodies = of_bodies[rows]
    if (simple := bodies[(bodies > 0) & (model.body_simple[bodies] > 0)]).size:
        whose = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, simple[0]) or f"number {simple[0]}"
        told = f"C MuJoCo cannot move {name} of body {whose}, whose mass matrix it has compiled as a diagonal one"
        raise InputError(f"{told}; write simple='false' at that <body>, or take engine mjx")


def put(model: mujoco.MjModel, fields: Mapping[str, Any], write: Callable[[str, Any], None], derive: Callable) -> None:
    """Fields into C MuJoCo, as MJX would have them: by `write`, for one model or many at a time.

    C skips work by what was derived from fields: a geom that lies at its body's frame, a mass matrix that is constant.
    That `derive` computes again, by `mj_setConst`; what MJX reads of it stays as it is in the fields and the `model`.
    """
    for name, value in fields.items():
        write(name, value)
    if any(name.startswith("opt.") or name in _READ for name in fields):
        derive()
        kept = {name: getattr(model, name) for name in sorted(_WRITTEN & float_fields() - _OWN)}
        for name, value in {**kept, **fields}.items():
            if name not in _OWN:
                write(name, value)
