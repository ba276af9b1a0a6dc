"""A scene's motion on C MuJoCo with its derivatives, and a record of what happens on the way. Nothing is compiled.

The derivatives are the engine's: each step linearised, and a sweep over the linear steps, here in NumPy.
"""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Array, Float

from tog_mjx.checks.measured.met import Met
from tog_mjx.checks.measured.motion import NEVER, SAMPLES, Motion, Recorder
from tog_mjx.checks.measured.seen import Seen
from tog_mjx.engines.c_mujoco.forward import Forward, check_state
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.engines.engine import make_engine
from tog_mjx.engines.simulator import check_names
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.problems.wrt import OF_DATA
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.mjx_state import INPUTS, MOVING, STATE, copy_of
from tog_mjx.stepping.tangents import in_velocity_space, state_basis
from tog_mjx.stepping.velocity_space import position_basis

_NUMBERS = 2**21
"""Of float64 in an array, 16 MB: of states of many motions, or of linear steps."""
_MOVED = ("ctrl", *MOVING)


def check_c(scene: SceneFunction) -> None:
    """Raises InputError for what C MuJoCo does not move, see or differentiate."""
    check_state(scene.model, "this scene")
    check_names("mujoco", {} if scene.differentiation == "implicit" else {"differentiation": scene.differentiation})
    if scene.x.array not in _MOVED:
        raise InputError(f"engine mujoco has derivatives in {', '.join(_MOVED)}, and none in {scene.x.array}; take mjx")
    if not isinstance(scene.y.output, str):
        raise InputError(
            "engine mujoco has no mjx.Data for a cost to see; take mjx, or a Problem, whose cost sees a State"
        )


class Linearised(Recorder):
    """On C MuJoCo; its models are MuJoCo's.

    Raises:
      InputError: see `check_c`.
    """

    engine = "mujoco"
    remedy = (
        "take engine mjx, which takes no differences: here one crosses a touch, or is rounded, as numbers are large"
    )

    def __init__(self, scene: SceneFunction, directions: Float[np.ndarray, "n k"]):
        check_c(scene)
        self.scene, self.directions, self.model = scene, directions, scene.model
        self._own = Forward(scene.model, scene.start, differentiation=scene.differentiation)
        self._seen = Seen(scene.y, self._own)

    def run(self, model: Any = None, steps: int | None = None, start: dict[str, Any] | None = None) -> Motion:
        steps, model = steps or self.scene.steps, model or self.model
        origin = copy_of(model, self.scene.start, **(start or {}))
        forward = self._own
        if start or model is not self.model:
            forward = Forward(model, origin, differentiation=self.scene.differentiation)
        ctrl = np.array(origin.ctrl)
        after = forward.motions(forward.start[None], np.tile(ctrl, (1, steps, 1)))[0]
        states = np.concatenate([forward.start[None], after])
        times = np.unique(np.append(np.arange(0, steps, -(-steps // SAMPLES)), steps))
        tangent, steered = self._tangents(states[0, 1 : forward.ends[1]])
        samples, last, bad_slope = self._swept(forward, states, ctrl, times, tangent, steered)
        seen, met = Seen(self.scene.y, forward), Met.of(forward, states, ctrl)
        is_finite = np.isfinite(states).all(axis=1)
        time, *moving, warm = np.split(states[times], forward.ends, axis=1)
        k = self.directions.shape[1]
        return Motion(
            value=seen.values(states[-1:], ctrl[None])[0],
            slopes=seen.slopes(states[-1], ctrl, last[:, :k], steered[:, :k]),
            bad_value=np.array([NEVER if is_finite.all() else is_finite.argmin()]),
            bad_slope=np.array([bad_slope]),
            times=times,
            moved=np.linalg.norm(samples[:, :, :k], axis=1),
            jacobians=samples[:, :, k:],
            states=dict(zip(STATE, (time[:, 0], *moving, warm), strict=True)),
            **met._asdict(),
        )

    def values(self, points: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N m"]:
        steps, found = self.scene.steps, []
        size = max(1, _NUMBERS // (steps * len(self._own.start)))
        for first in range(0, len(points), size):
            states, controls = self._placed(points[first : first + size])
            after = self._own.motions(states, np.repeat(controls[:, None], steps, axis=1))
            found.append(self._seen.values(after[:, -1], controls))
        return np.concatenate(found)

    def value(self, x: Float[Array, " n"]) -> Float[Array, " m"]:
        scene = self.scene
        problem = Problem(scene.model, scene.steps, cost=lambda state: state.time, start=scene.start)
        engine = make_engine(problem, "mujoco")
        model, start = scene.x.place(x, engine.model, {name: getattr(engine.origin, name) for name in OF_DATA})
        now = engine.begin(model, start), start["ctrl"]
        now, _ = engine.run(model, now, start["ctrl"], scene.steps, 1, None, lambda _: None)
        return scene.y.seen(engine.state(model, *now))

    def changed(self, numbers: Mapping[str, Any]) -> mujoco.MjModel:
        model = copy.copy(self.model)
        for name, value in numbers.items():
            owner = model.opt if name.startswith("opt.") else model
            setattr(owner, name.removeprefix("opt."), value)
        return model

    def differentiated(self, differentiation: str) -> Motion:
        return Linearised(dataclasses.replace(self.scene, differentiation=differentiation), self.directions).run()

    def displaced(self, x: Float[np.ndarray, " n"]) -> tuple[mujoco.MjModel, dict[str, Any]]:
        states, controls = self._placed(x[None])
        time, *moving, warm = np.split(states[0], self._own.ends)
        inputs = {name: np.array(getattr(self.scene.start, name)) for name in INPUTS}
        return self.model, {
            **dict(zip(STATE, (time[0], *moving, warm), strict=True)),
            **inputs,
            "ctrl": controls[0],
        }

    def _placed(self, points: Float[np.ndarray, "N n"]) -> tuple[np.ndarray, np.ndarray]:
        """Starts [N, s] and controls [N, nu] at displacements."""
        x, (_, q, v, a) = self.scene.x, self._own.ends
        states, controls = np.tile(self._own.start, (len(points), 1)), np.tile(self.scene.start.ctrl, (len(points), 1))
        change = np.zeros((len(points), x.mask.size))
        change[:, x.chosen] = points
        match x.array:
            case "ctrl":
                controls += change
            case "qpos":
                for state, one in zip(states, change, strict=True):
                    mujoco.mj_integratePos(self.model, state[1:q], one, 1.0)
            case "qvel":
                states[:, q:v] += change
            case "act":
                states[:, v:a] += change
        return states, controls

    def _tangents(self, qpos: Float[np.ndarray, " nq"]) -> tuple[np.ndarray, np.ndarray]:
        """Those of the start [n, K] and of the controls [nu, K]: along the directions, then of each number of the
        start."""
        x, model = self.scene.x, self.model
        change = np.zeros((x.mask.size, self.directions.shape[1]))
        change[x.chosen] = self.directions
        parts = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu}
        moved = {name: np.zeros((size, change.shape[1])) for name, size in parts.items()}
        moved[x.array] = position_basis(model, qpos) @ change if x.array == "qpos" else change
        *start, steered = moved.values()
        basis = state_basis(model, qpos).T
        return np.hstack([np.concatenate(start), basis]), np.hstack([steered, np.zeros((model.nu, basis.shape[1]))])

    def _swept(
        self,
        forward: Forward,
        states: Float[np.ndarray, "T s"],
        ctrl: Float[np.ndarray, " nu"],
        times: np.ndarray,
        tangent: Float[np.ndarray, "n K"],
        steered: Float[np.ndarray, "nu K"],
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """The tangents of the states at some times [S, 2 nv + na, K], in velocity space, and of the last state [n, K];
        and the first step in which they are not finite."""
        bad, is_sample = NEVER, np.isin(np.arange(len(states)), times)
        found, size = (
            [self._in_velocity_space(states[0], tangent)],
            max(1, _NUMBERS // (len(tangent) * (len(tangent) + len(ctrl)))),
        )
        for first in range(0, len(states) - 1, size):
            before, after = states[:-1][first : first + size], states[first + 1 :][:size]
            steps = slopes(forward, before, after, np.tile(ctrl, (len(before), 1)))
            for i, (of_state, of_controls) in enumerate(zip(steps.state, steps.controls, strict=True), first + 1):
                tangent = of_state @ tangent + of_controls @ steered
                bad = bad if np.isfinite(tangent).all() else min(bad, i)
                if is_sample[i]:
                    found.append(self._in_velocity_space(states[i], tangent))
        return np.array(found), tangent, bad

    def _in_velocity_space(self, state: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        return in_velocity_space(self.model, state[1 : self._own.ends[1]], tangent.T).T
