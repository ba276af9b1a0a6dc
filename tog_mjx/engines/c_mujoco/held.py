"""What is held during a motion: numbers of the model, and the poses of mocap bodies.

A row of it [h] has the change of the model [n], mocap positions [3 nmocap] and orientations [4 nmocap], and the fields
that were drawn, one after another.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from tog_mjx.mjcf.fields import assign, attribute
from tog_mjx.mjcf.moved import MovedModel, put
from tog_mjx.stepping.velocity_space import turns

Rows = Float[np.ndarray, "N h"]

_LONGER = 10
"""A difference in a number of the model, relative to that, than one in a position: masses and time steps of the flip
and the grasp then agree with MJX's to 2e-8, and by equal ones to 2e-7."""


class Held(NamedTuple):
    """The parts of a row, on JAX. Nothing is differentiated in what was drawn."""

    change: Float[Array, " n"]
    mocap: Float[Array, " 7_nmocap"]
    drawn: Float[Array, " f"]

    @classmethod
    def of(cls, model: MovedModel, start: dict[str, Array]) -> "Held":
        """Of a model, and of a start by the names of its fields in `mjx.Data`."""
        dtype = start["qpos"].dtype

        def flat(arrays: list[Array]) -> Array:
            return jnp.concatenate([jnp.zeros(0, dtype), *(jnp.ravel(some).astype(dtype) for some in arrays)])

        poses = flat([start["mocap_pos"], start["mocap_quat"]])
        return cls(jnp.asarray(model.change, dtype), poses, flat(list(model.drawn.values())))

    def poses(self) -> dict[str, Array]:
        """Those of mocap bodies, by their names in `mjx.Data`."""
        pos, quat = jnp.split(self.mocap, [3 * (self.mocap.size // 7)])
        return {"mocap_pos": pos.reshape(-1, 3), "mocap_quat": quat.reshape(-1, 4)}


def instantiated(tangent: Any) -> Array:
    """A tangent, also of what does not move."""
    return jnp.zeros(tangent.shape, tangent.dtype) if isinstance(tangent, SymbolicZero) else tangent


def is_moved(tangents: Sequence[Any]) -> bool:
    """Whether a derivative in any of them is asked for."""
    return any(not isinstance(some, SymbolicZero) and some.size for some in tangents)


class Layout:
    """Where the numbers of a row belong."""

    def __init__(self, model: MovedModel):
        self.model, self.rates, self.size = model.model, model.rates, _LONGER * model.size
        self.drawn = {name: np.shape(attribute(self.model, name)) for name in model.drawn}
        poses = 3 * self.model.nmocap, 4 * self.model.nmocap
        self.ends = np.cumsum([len(self.size), *poses])
        self.turning = len(self.size) + 3 * self.model.nmocap
        """The first of the directions that turn."""
        self.directions = self.turning + 3 * self.model.nmocap
        """A row moves in: the change, in units of its own, and mocap bodies' velocities."""

    @functools.cached_property
    def identity(self) -> bytes:
        """Of all that a row means."""
        rates = [(name, rate.shape, rate.tobytes()) for name, rate in self.rates.items()]
        return repr((rates, self.size.tobytes(), self.drawn)).encode()

    @property
    def moves_model(self) -> bool:
        """Whether rows move the model."""
        return bool(self.rates or self.drawn)

    def row(self, data: mujoco.MjData) -> Float[np.ndarray, " h"]:
        """Of the model as it is, and the poses in data."""
        drawn = [np.ravel(attribute(self.model, name)) for name in self.drawn]
        return np.concatenate([np.zeros(len(self.size)), data.mocap_pos.ravel(), data.mocap_quat.ravel(), *drawn])

    def displaced(self, rows: Rows, along: Float[np.ndarray, "S d"]) -> Float[np.ndarray, "N S h"]:
        """Each row, displaced in each of some ways."""
        change, pos, quat, drawn = np.split(np.repeat(rows[:, None], len(along), 1), self.ends, axis=2)
        n, turning = len(self.size), self.turning
        of_quat = self._turns(rows) @ along[:, turning:].T
        moved = change + along[:, :n] * self.size, pos + along[:, n:turning], quat + of_quat.swapaxes(1, 2)
        return np.concatenate([*moved, drawn], axis=2)

    def in_numbers(self, rows: Rows, slopes: Float[np.ndarray, "N r d"]) -> Float[np.ndarray, "N r m"]:
        """Derivatives in the directions as those in the numbers of the change and the mocap poses."""
        n, turning = len(self.size), self.turning
        of_change, of_pos, of_turn = np.split(slopes, [n, turning], axis=2)
        # Of a unit quaternion the part along the turn counts, twice.
        of_quat = of_turn @ (4 * self._turns(rows).swapaxes(1, 2))
        return np.concatenate([of_change / self.size, of_pos, of_quat], axis=2)

    def _turns(self, rows: Rows) -> Float[np.ndarray, "N q v"]:
        """The derivative of all mocap orientations in their rotation vectors."""
        nmocap = self.model.nmocap
        quat = rows[:, self.ends[1] : self.ends[2]].reshape(len(rows), nmocap, 4)
        each = turns(quat / np.linalg.norm(quat, axis=2, keepdims=True))
        return np.einsum("nbij,bc->nbicj", each, np.eye(nmocap)).reshape(len(rows), 4 * nmocap, 3 * nmocap)

    def hold(self, batch: mujoco.batch.Batch, rows: Rows) -> None:
        """Puts them into the first simulations of a batch, one each."""
        count = len(rows)

        def write(name: str, value: np.ndarray) -> None:
            batch.expand(name)[:count] = value

        if self.moves_model:
            put(self.model, self._fields(rows), write, lambda: batch.set_const(np.arange(count)))
        if nmocap := self.model.nmocap:
            _, pos, quat, _ = np.split(rows, self.ends, axis=1)
            batch.mocap_pos[:count] = pos.reshape(count, nmocap, 3)
            batch.mocap_quat[:count] = quat.reshape(count, nmocap, 4)

    def hold_one(self, data: mujoco.MjData, row: Float[np.ndarray, " h"], whole: Float[np.ndarray, " w"]) -> None:
        """Puts it, and a whole state, into data and their model, which has to be a copy where the model moves."""
        if self.moves_model:
            fields = {name: value[0] for name, value in self._fields(row[None]).items()}
            put(self.model, fields, functools.partial(assign, data.model), lambda: mujoco.mj_setConst(data.model, data))
        mujoco.mj_setState(self.model, data, whole, mujoco.mjtState.mjSTATE_INTEGRATION)
        _, pos, quat, _ = np.split(row, self.ends)
        data.mocap_pos[:], data.mocap_quat[:] = pos.reshape(-1, 3), quat.reshape(-1, 4)

    def _fields(self, rows: Rows) -> dict[str, np.ndarray]:
        change, _, _, drawn = np.split(rows, self.ends, axis=1)
        ends = np.cumsum([int(np.prod(shape)) for shape in self.drawn.values()])[:-1]
        given = dict(zip(self.drawn, np.split(drawn, ends, axis=1), strict=True)) if self.drawn else {}
        found = {}
        for name in {**self.drawn, **self.rates}:
            own = np.asarray(attribute(self.model, name))
            value = given.get(name, own.reshape(1, -1))
            if name in self.rates:
                value = value + change @ self.rates[name].T
            found[name] = np.broadcast_to(value, (len(rows), own.size)).reshape(len(rows), *own.shape)
        return found
