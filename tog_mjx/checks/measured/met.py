"""What C MuJoCo's steps leave beside the next state: how deep geoms sink into each other, and what the solver lacks."""

import copy
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.mjcf.pairs import geom_pairs

_LOOKS = 20
"""States in which the distances of what does not touch are measured."""
_DISTANCES = 20_000
"""Of them in all, at most: each takes some microseconds."""
_FAR = 1e3
"""m. Beyond it nothing is measured."""
_PLACED = (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
"""Geoms whose distances MuJoCo knows from their contacts alone."""
_EXACT = {"iterations": 200, "ls_iterations": 100, "tolerance": 1e-15, "solver": mujoco.mjtSolver.mjSOL_NEWTON}


class Met(NamedTuple):
    """As a `Motion` has them: distance [C], distance_step [C], geoms [C, 2], and the solver's correction."""

    distance: np.ndarray
    distance_step: np.ndarray
    geoms: np.ndarray
    correction: np.ndarray

    @classmethod
    def of(cls, forward: Forward, states: Float[np.ndarray, "T s"], ctrl: Float[np.ndarray, " nu"]) -> "Met":
        """Of the steps between states, under the controls held."""
        model = forward.model
        exact = copy.copy(model)
        for name, value in _EXACT.items():
            setattr(exact.opt, name, value)
        pairs = _watched(model)
        looks = np.linspace(0, len(states) - 2, int(np.clip(_DISTANCES // max(len(pairs), 1), 1, _LOOKS))).astype(int)
        nearest: dict[tuple[int, int], tuple[float, int]] = {}
        correction = 0.0
        with forward.data() as data:
            for step, state in enumerate(states[:-1]):
                if not np.isfinite(state).all():
                    break
                mujoco.mj_setState(model, data, state, STATE)
                data.ctrl[:] = ctrl
                mujoco.mj_forward(model, data)
                for pair, distance in _contacts(data) + (_distances(model, data, pairs) if step in looks else []):
                    if pair not in nearest or distance < nearest[pair][0]:
                        nearest[pair] = distance, step
                correction = float(np.maximum(correction, _correction(exact, data)))  # NaN stays.
        distances, steps = np.array(list(nearest.values())).reshape(-1, 2).T
        return cls(distances, steps.astype(int), np.array(list(nearest), int).reshape(-1, 2), np.array(correction))


def _watched(model: mujoco.MjModel) -> list[tuple[int, int, float]]:
    """Pairs of geoms that may touch and are of kinds whose distance is known, and the margin of each."""
    off = mujoco.mjtDisableBit
    if model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT):
        return []
    found = []
    for first, second, pair in geom_pairs(model):
        geoms = [first, second]
        margin = model.pair_margin[pair] if pair >= 0 else model.geom_margin[geoms].sum()
        if not np.isin(model.geom_type[geoms], _PLACED).any():
            found.append((min(geoms), max(geoms), float(margin)))
    return found


def _contacts(data: mujoco.MjData) -> list[tuple[tuple[int, int], float]]:
    """Those of two geoms: which, and how far their surfaces are, less the margin."""
    pairs, distances = np.sort(data.contact.geom, axis=1), data.contact.dist - data.contact.includemargin
    # Of what is no geom, as a flex, the number is -1.
    return [((i, j), distance) for (i, j), distance in zip(pairs.tolist(), distances.tolist(), strict=True) if i >= 0]


def _distances(model: mujoco.MjModel, data: mujoco.MjData, pairs: list) -> list[tuple[tuple[int, int], float]]:
    touching = {pair for pair, _ in _contacts(data)}
    return [
        ((i, j), mujoco.mj_geomDistance(model, data, i, j, _FAR, None) - margin)
        for i, j, margin in pairs
        if (i, j) not in touching
    ]


def _correction(exact: mujoco.MjModel, data: mujoco.MjData) -> float:
    """How far the solver's answer in `data` is from the exact one, relative to the accelerations at play. It solves
    again there."""
    if not data.nefc:
        return 0.0
    given = data.qacc.copy()
    size = np.linalg.norm(given) + np.linalg.norm(data.qacc_smooth)
    data.qacc_warmstart[:] = given
    mujoco.mj_fwdConstraint(exact, data)
    return float(np.linalg.norm(data.qacc - given) / size) if size else 0.0
