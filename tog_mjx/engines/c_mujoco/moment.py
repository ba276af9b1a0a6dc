"""Numbers y [m] that C MuJoCo finds at a moment, and their slopes: places by Jacobians, all else by differences.

A moment is a state s, see `forward`, the controls in force, and what is held: whatever the integrator, y is what
`mj_forward` finds there.
"""

import abc
import dataclasses
import functools
from dataclasses import dataclass
from typing import TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.engines.c_mujoco.held import Rows
from tog_mjx.engines.c_mujoco.linearise import centred
from tog_mjx.engines.c_mujoco.threads import for_each

States: TypeAlias = Float[np.ndarray, "N s"]
Controls: TypeAlias = Float[np.ndarray, "N nu"]
POS, VEL, ACC = (int(getattr(mujoco.mjtStage, f"mjSTAGE_{name}")) for name in ("POS", "VEL", "ACC"))
QACC = ACC + 1
_JACOBIANS = {mujoco.mjtObj.mjOBJ_SITE: mujoco.mj_jacSite, mujoco.mjtObj.mjOBJ_BODY: mujoco.mj_jacBody}


@dataclass(frozen=True)
class Numbers(abc.ABC):
    """y [m] of a moment."""

    forward: Forward

    @property
    @abc.abstractmethod
    def size(self) -> int: ...

    @property
    @abc.abstractmethod
    def which(self) -> tuple[int, ...]:
        """What tells them from others of the same engine."""

    @property
    def identity(self) -> np.ndarray:
        return np.append(self.forward.identity, np.array(self.which, np.uint32))

    @property
    def precise(self) -> "Numbers":
        """The same for differences, see `Forward.precise`."""
        return dataclasses.replace(self, forward=self.forward.precise)

    @abc.abstractmethod
    def values(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        """[N, m] of N moments."""

    @abc.abstractmethod
    def slopes(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        """In (velocity space, qvel, act, ctrl), [N, m, 2 nv + na + nu]."""

    def in_held(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        """In the numbers of what is held, [N, m, ...], by differences."""
        layout, usable = self.forward.layout, np.flatnonzero(np.isfinite(states).all(1))
        ways = layout.directions

        def one_sided(members: np.ndarray, step: float) -> np.ndarray:
            along = step * np.concatenate([np.zeros((1, ways)), np.eye(ways), -np.eye(ways)])
            rows = layout.displaced(held[members], along)
            given = states[members].repeat(len(along), 0), controls[members].repeat(len(along), 0)
            found = self.values(*given, rows.reshape(-1, rows.shape[2]))
            found = found.reshape(len(members), len(along), self.size)
            change = (found[:, 1:] - found[:, :1]).swapaxes(1, 2) / step
            return np.stack([change[..., :ways], -change[..., ways:]])

        found = np.full((len(states), self.size, ways), np.nan)
        if found.size:
            found[usable] = centred(one_sided, usable)
        return layout.in_numbers(held, found)


@dataclass(frozen=True)
class Place(Numbers):
    """Where a site or a body is, in m."""

    kind: mujoco.mjtObj
    number: int

    @property
    def size(self) -> int:
        return 3

    @property
    def which(self) -> tuple[int, ...]:
        return int(self.kind), self.number

    def values(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        del controls
        found = np.empty((len(states), 3))

        def one(data: mujoco.MjData, i: int) -> None:
            mujoco.mj_setState(data.model, data, states[i], STATE)
            mujoco.mj_kinematics(data.model, data)
            found[i] = (data.site_xpos if self.kind == mujoco.mjtObj.mjOBJ_SITE else data.xpos)[self.number]

        for_each(self.forward, held, one)
        return found

    def slopes(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        del controls
        model = self.forward.model
        found = np.zeros((len(states), 3, 2 * model.nv + model.na + model.nu))
        jacobians = np.empty((len(states), 3, model.nv))

        def one(data: mujoco.MjData, i: int) -> None:
            mujoco.mj_setState(data.model, data, states[i], STATE)
            mujoco.mj_kinematics(data.model, data)
            mujoco.mj_comPos(data.model, data)
            _JACOBIANS[self.kind](data.model, data, jacobians[i], None, self.number)

        for_each(self.forward, held, one)
        found[..., : model.nv] = jacobians
        return found


@dataclass(frozen=True)
class Dynamics(Numbers):
    """All sensordata, zero where they need a later `stage`; or, one stage beyond, the accelerations."""

    stage: int

    @property
    def size(self) -> int:
        return self.forward.model.nv if self.stage == QACC else self.forward.model.nsensordata

    @property
    def which(self) -> tuple[int, ...]:
        return (self.stage,)

    @functools.cached_property
    def _known(self) -> np.ndarray:
        model = self.forward.model
        return np.repeat(model.sensor_needstage <= self.stage, model.sensor_dim)

    def values(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        found = np.full((len(states), self.size), np.nan)

        def one(data: mujoco.MjData, i: int) -> None:
            mujoco.mj_setState(data.model, data, states[i], STATE)
            data.ctrl[:] = controls[i]
            found[i] = self._of(data)

        usable = np.flatnonzero(np.isfinite(states).all(1))
        for_each(self.forward, held[usable], lambda data, i: one(data, int(usable[i])))
        return found

    def slopes(self, states: States, controls: Controls, held: Rows) -> np.ndarray:
        model = self.forward.model
        found = np.full((len(states), self.size, 2 * model.nv + model.na + model.nu), np.nan)
        usable = np.flatnonzero(np.isfinite(states).all(1))

        def one_sided(members: np.ndarray, step: float) -> np.ndarray:
            both = np.zeros((2, len(members), *found.shape[1:]))

            def one(data: mujoco.MjData, i: int) -> None:
                for side, length in enumerate((step, -step)):
                    self._differences(data, states[members[i]], controls[members[i]], length, both[side, i])

            for_each(self.forward, held[members], one)
            return both

        if found.size:
            found[usable] = centred(one_sided, usable)
        return found

    def _differences(
        self, data: mujoco.MjData, state: np.ndarray, controls: np.ndarray, length: float, out: np.ndarray
    ) -> None:
        """One-sided ones, [m, 2 nv + na + nu]. Of what a variable does not move nothing is computed again."""
        model = data.model
        nv, na = model.nv, model.na
        mujoco.mj_setState(model, data, state, STATE)
        data.ctrl[:] = controls
        base, warm = self._of(data), state[self.forward.ends[-1] :]

        def moved(column: int, values: np.ndarray, i: int, length: float, done: int) -> None:
            before = values[i]
            values[i] += length
            data.qacc_warmstart[:] = warm
            out[:, column] = (self._of(data, done) - base) / length
            values[i] = before

        if self.stage >= ACC:
            # A control at its limit is moved inward.
            inward = np.where(_beyond(model, controls + length), -length, length)
            for i in range(model.nu):
                moved(2 * nv + na + i, data.ctrl, i, inward[i], VEL)
            for i in range(na):
                moved(2 * nv + i, data.act, i, length, VEL)
        if self.stage >= VEL:
            for i in range(nv):
                moved(nv + i, data.qvel, i, length, POS)
        qpos, turn = data.qpos.copy(), np.zeros(nv)
        for i in range(nv):
            turn[i] = length
            mujoco.mj_integratePos(model, data.qpos, turn, 1.0)
            data.qacc_warmstart[:] = warm
            out[:, i] = (self._of(data) - base) / length
            data.qpos[:], turn[i] = qpos, 0.0

    def _of(self, data: mujoco.MjData, done: int = 0) -> np.ndarray:
        """y, where the stages up to `done` are those of the data."""
        model = data.model
        if self.stage == QACC:
            mujoco.mj_forwardSkip(model, data, done, True)
            return data.qacc.copy()
        if self.stage == ACC:
            mujoco.mj_forwardSkip(model, data, done, False)
            return data.sensordata.copy()
        if done < POS:
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_sensorPos(model, data)
        if self.stage == VEL:
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
        return np.where(self._known, data.sensordata, 0.0)


def _beyond(model: mujoco.MjModel, controls: np.ndarray) -> np.ndarray:
    low, high = model.actuator_ctrlrange.T
    return model.actuator_ctrllimited.astype(bool) & ((controls < low) | (controls > high))
