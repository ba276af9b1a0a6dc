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

from tog_mjx.checks.measured.agreement import OF_C_MUJOCO
from tog_mjx.checks.measured.met import Met
from tog_mjx.checks.measured.motion import NEVER, SAMPLES, Motion, Recorder
from tog_mjx.checks.measured.placed import STARTED, Given, layout_of, starts, tangents
from tog_mjx.checks.measured.seen import Seen
from tog_mjx.engines.c_mujoco.forward import Forward, check_state
from tog_mjx.engines.c_mujoco.linearise import slopes
from tog_mjx.engines.c_mujoco.switching import check_jumps
from tog_mjx.engines.engine import make_engine
from tog_mjx.engines.simulator import check_names
from tog_mjx.problems.problem import Problem
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.problems.variables import Start
from tog_mjx.problems.wrt import OF_DATA
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.mjx_state import INPUTS, STATE, copy_of
from tog_mjx.stepping.tangents import in_velocity_space

_NUMBERS = 2**21
"""Of float64 in an array, 16 MB: of states of many motions, or of linear steps."""


def check_c(scene: SceneFunction) -> None:
    """Raises InputError for what C MuJoCo does not move, see or differentiate."""
    check_state(scene.model, "this scene")
    check_names("mujoco", {"differentiation": scene.differentiation})
    if scene.differentiation == "saltation":
        check_jumps(scene.model)
    layout_of(scene.x, scene.model)
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
    remedy = OF_C_MUJOCO

    def __init__(self, scene: SceneFunction, directions: Float[np.ndarray, "n k"]):
        check_c(scene)
        self.scene, self.directions, self.model = scene, directions, scene.model
        self._own = self._forward(scene.model, scene.start)
        self._seen = Seen(scene.y, self._own)
        self._is_held = scene.x.array not in STARTED

    def _forward(self, model: mujoco.MjModel, origin: mujoco.MjData) -> Forward:
        differentiation, layout = self.scene.differentiation, layout_of(self.scene.x, model)
        return Forward(model, origin, differentiation=differentiation, layout=layout)

    def run(self, model: Any = None, steps: int | None = None, start: dict[str, Any] | None = None) -> Motion:
        steps, model = steps or self.scene.steps, model or self.model
        origin = copy_of(model, self.scene.start, **(start or {}))
        forward = self._forward(model, origin) if start or model is not self.model else self._own
        ctrl = np.array(origin.ctrl)
        after = forward.motions(forward.start[None], np.tile(ctrl, (1, steps, 1)))[0]
        states = np.concatenate([forward.start[None], after])
        times = np.unique(np.append(np.arange(0, steps, -(-steps // SAMPLES)), steps))
        along = tangents(self.scene.x, forward, states[0], self.directions)
        samples, last, bad_slope = self._swept(forward, states, ctrl, times, along)
        seen, met = Seen(self.scene.y, forward), Met.of(forward, states, ctrl)
        is_finite = np.isfinite(states).all(axis=1)
        time, *moving, warm = np.split(states[times], forward.ends, axis=1)
        k, end = self.directions.shape[1], Given(states[-1:], ctrl[None], forward.row[None])
        return Motion(
            value=seen.values(end)[0],
            slopes=seen.slopes(end, Given(*(some[:, :k] for some in (last, *along[1:]))), self._is_held),
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
            given = starts(self.scene.x, self._own, self.scene.start.ctrl, points[first : first + size])
            rows = np.repeat(given.controls[:, None], steps, axis=1)
            after = self._own.motions(given.states, rows, given.held if self._is_held else None)
            found.append(self._seen.values(given._replace(states=after[:, -1])))
        return np.concatenate(found)

    def value(self, x: Float[Array, " n"]) -> Float[Array, " m"]:
        scene = self.scene
        # Variables are moved by the scene function, so the problem's are any that every scene has.
        problem = Problem(scene.model, scene.steps, Start("qvel"), cost=lambda state: state.time, start=scene.start)
        engine = make_engine(problem, "mujoco", differentiation=scene.differentiation)
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
        given = starts(self.scene.x, self._own, self.scene.start.ctrl, x[None])
        time, *moving, warm = np.split(given.states[0], self._own.ends)
        data = mujoco.MjData(copy.copy(self.model))
        self._own.layout.hold_one(data, given.held[0], self._own.whole)
        inputs = {name: np.array(getattr(data, name)) for name in INPUTS}
        state = dict(zip(STATE, (time[0], *moving, warm), strict=True))
        model = data.model if self._own.layout.moves_model else self.model
        return model, {**state, **inputs, "ctrl": given.controls[0]}

    def _swept(
        self,
        forward: Forward,
        states: Float[np.ndarray, "T s"],
        ctrl: Float[np.ndarray, " nu"],
        times: np.ndarray,
        along: Given,
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """The tangents of the states at some times [S, 2 nv + na, K], in velocity space, and of the last state [n, K];
        and the first step in which they are not finite."""
        tangent, steered, held = along
        bad, is_sample = NEVER, np.isin(np.arange(len(states)), times)
        found = [self._in_velocity_space(states[0], tangent)]
        size = max(1, _NUMBERS // (len(tangent) * sum(map(len, along))))
        for first in range(0, len(states) - 1, size):
            before, after = states[:-1][first : first + size], states[first + 1 :][:size]
            steps = slopes(forward, before, after, np.tile(ctrl, (len(before), 1)), is_held=self._is_held)
            pushed = steps.controls @ steered
            if self._is_held:
                pushed = pushed + steps.held[:, 1:] @ held
            for i, (of_state, more) in enumerate(zip(steps.state, pushed, strict=True), first + 1):
                tangent = of_state @ tangent + more
                bad = bad if np.isfinite(tangent).all() else min(bad, i)
                if is_sample[i]:
                    found.append(self._in_velocity_space(states[i], tangent))
        return np.array(found), tangent, bad

    def _in_velocity_space(self, state: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        return in_velocity_space(self.model, state[1 : self._own.ends[1]], tangent.T).T
