"""Motions of C MuJoCo, many at a time, on all cores.

A state is MuJoCo's own vector s [1 + nq + nv + na + nv]: time, qpos, qvel, act, and the warm start of the solver. What
is held, h, is a row of a `Layout`: numbers of the model and poses of mocap bodies. All else that a step reads is an
input, and stays as the problem's start has it.
"""

import contextlib
import copy
import functools
import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import mujoco
import mujoco.batch
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.held import Layout
from tog_mjx.mjcf.moved import MovedModel
from tog_mjx.running.devices import cores
from tog_mjx.running.digests import scene_digest
from tog_mjx.running.errors import InputError
from tog_mjx.running.interruption import has_come

Kind = TypeVar("Kind")
_PART = mujoco.mjtState
STATE = sum(
    int(part)
    for part in (_PART.mjSTATE_TIME, _PART.mjSTATE_QPOS, _PART.mjSTATE_QVEL, _PART.mjSTATE_ACT, _PART.mjSTATE_WARMSTART)
)
WHOLE = int(_PART.mjSTATE_INTEGRATION)
WARNED = 1
PRECISE = 1e-14
"""Tolerance of the solver in differences of 1e-6 or 1e-8: Newton's method needs one iteration more for it, or none."""
NEWTON = 100
"""Its iterations at least, where it stands in for another solver; it needs fewer than ten."""
AT_ONCE = 10_000
"""Steps of a thread during which Python looks for no signals: a tenth of a second to a few."""
_HIDDEN = {
    "delays": _PART.mjSTATE_HISTORY,
    "user data": _PART.mjSTATE_USERDATA,
    "plugins": _PART.mjSTATE_PLUGIN,
    "plastic bodies": _PART.mjSTATE_PLASTIC,
}
"""What would have a state beside s."""


class Forward:
    """The motions of a model under the inputs of a start, and how they are differentiated: "implicit" or "saltation".
    Any number of threads may call it at once.

    MuJoCo prints a warning, and writes it to a file in the working folder, if it is the first of its kind: here each
    counts as the second one. A model that began anew after a burst would forget that; this copy goes on.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        origin: mujoco.MjData,
        threads: int | None = None,
        differentiation: str = "implicit",
        layout: Layout | None = None,
    ):
        self.model, self.threads, self.differentiation = copy.copy(model), threads or cores(), differentiation
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.layout = layout or Layout(MovedModel.of(model))
        self.whole, self.start = (np.zeros(mujoco.mj_stateSize(model, spec)) for spec in (WHOLE, STATE))
        mujoco.mj_getState(model, origin, self.whole, WHOLE)
        mujoco.mj_getState(model, origin, self.start, STATE)
        self.row = self.layout.row(origin)
        told = f"{scene_digest(model)}{mujoco.__version__}{differentiation}".encode()
        digest = hashlib.sha256(told + self.whole.tobytes() + self.layout.identity).digest()
        self.identity = np.frombuffer(digest, np.uint32)
        """Of all that a motion depends on beside its state, its controls and what is held."""
        self.ends = np.cumsum([1, model.nq, model.nv, model.na])
        """Where time, qpos, qvel and act end in s."""
        # Making one costs more than a step of a small model. Every call takes what nobody uses, and sets all of it.
        self.idle: defaultdict[int, list[mujoco.batch.Batch]] = defaultdict(list)
        self.spare: list[mujoco.MjData] = []
        self.rooms: list[Any] = []
        """Those of `switching`."""
        self._others: dict[bytes, Forward] = {}

    @functools.cached_property
    def precise(self) -> "Forward":
        """The same for differences: a solver with the tolerance of motions takes what a difference changes for nothing,
        where it begins at its answer. That of PGS is too rough for any: there Newton's method stands in, whose answer
        PGS converges to."""
        other = copy.copy(self)
        other.model = copy.copy(self.model)
        option = other.model.opt
        option.tolerance = min(option.tolerance, PRECISE)
        option.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE  # Of no effect on motions.
        if option.solver == mujoco.mjtSolver.mjSOL_PGS:
            option.solver, option.iterations = mujoco.mjtSolver.mjSOL_NEWTON, max(option.iterations, NEWTON)
        other.idle, other.spare, other.rooms = defaultdict(list), [], []
        return other

    def holding(self, model: MovedModel) -> "Forward":
        """The same with rows of what moves that model; one for all equal ones."""
        layout = Layout(model)
        if layout.identity == self.layout.identity:
            return self
        if layout.identity not in self._others:
            with self.data() as origin:
                other = Forward(self.model, origin, self.threads, self.differentiation, layout)
            self._others.setdefault(layout.identity, other)
        return self._others[layout.identity]

    def motions(
        self,
        states: Float[np.ndarray, "N s"],
        controls: Float[np.ndarray, "N k nu"],
        held: Float[np.ndarray, "N h"] | None = None,
    ) -> np.ndarray:
        """The states after each of k steps, [N, k, s], the same to the bit for any number of threads. From where
        MuJoCo warns that a motion has burst they are NaN."""
        count, steps, _ = controls.shape
        most = self.threads * max(1, AT_ONCE // steps)
        if count <= most:
            return self._at_once(states, controls, held)
        parts = [slice(first, first + most) for first in range(0, count, most)]
        rows = [None if held is None else held[part] for part in parts]
        given = zip(parts, rows, strict=True)
        return np.concatenate([self._at_once(states[part], controls[part], some) for part, some in given])

    def _at_once(self, states: np.ndarray, controls: np.ndarray, held: np.ndarray | None) -> np.ndarray:
        if has_come():
            raise KeyboardInterrupt
        count, steps, _ = controls.shape
        with self.batch(count, held) as batch:
            batch.state[:, : states.shape[1]] = states
            found: np.ndarray = batch.rollout(steps, controls, record=(STATE,))[STATE]
            burst = (batch.warning[..., 1] > WARNED).any(1)
        for i in np.flatnonzero(burst):
            # Its steps after the last one repeat that one, in which MuJoCo warned.
            found[i, np.argmax(found[i, :, 0] == found[i, -1, 0]) :] = np.nan
        return found

    @contextlib.contextmanager
    def batch(self, count: int, held: Float[np.ndarray, "n h"] | None = None) -> Iterator[mujoco.batch.Batch]:
        """So many simulations that nobody uses, with the inputs and, the first ones, with what is held."""
        idle = self.idle[count]
        batch = taken(idle, lambda: mujoco.batch.Batch(self.model, count, min(self.threads, count)))
        batch.state[:] = self.whole
        batch.warning[:] = WARNED
        if held is not None:
            self.layout.hold(batch, held)
        yield batch
        idle.append(batch)

    @contextlib.contextmanager
    def data(self) -> Iterator[mujoco.MjData]:
        """Data that nobody uses, with the inputs; of a model of their own where that moves."""
        data = taken(self.spare, self._new)
        mujoco.mj_setState(self.model, data, self.whole, WHOLE)
        yield data
        self.spare.append(data)

    def hold(self, data: mujoco.MjData, held: Float[np.ndarray, " h"]) -> None:
        """Puts it and the inputs into such data and their model."""
        self.layout.hold_one(data, held, self.whole)

    def _new(self) -> mujoco.MjData:
        data = mujoco.MjData(copy.copy(self.model) if self.layout.moves_model else self.model)
        for kind in data.warning:
            kind.number = WARNED
        return data


def taken(idle: list[Kind], make: Callable[[], Kind]) -> Kind:
    try:
        return idle.pop()
    except IndexError:
        return make()


def check_state(model: mujoco.MjModel, name: str) -> None:
    """Raises InputError for a model whose steps depend on more than time, positions, velocities and activations."""
    found = [what for what, part in _HIDDEN.items() if mujoco.mj_stateSize(model, int(part))]
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        found.append("sleeping bodies")
    if found:
        raise InputError(f"{name}: engine mujoco has no state for {' and '.join(found)}; remove them")
