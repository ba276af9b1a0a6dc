"""Which geoms may meet: the pairs that MuJoCo looks at for contacts, on either engine."""

import mujoco
import numpy as np
from jaxtyping import Bool, Int


def geom_pairs(model: mujoco.MjModel) -> list[tuple[int, int, int]]:
    """Pairs of geoms, each ordered by type, and the number of their <pair>, -1 without one: first those of all <pair>s,
    then the others by their bodies."""
    given = _ordered(model, model.pair_geom1, model.pair_geom2)
    named = {frozenset(pair) for pair in given.tolist()}
    geoms = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    first, second = (geoms[some] for some in np.triu_indices(len(geoms), 1))
    meet = _may_meet(model, first, second)
    first, second = first[meet], second[meet]
    order = np.lexsort((second, first, model.geom_bodyid[second], model.geom_bodyid[first]))
    others = [pair for pair in _ordered(model, first[order], second[order]).tolist() if frozenset(pair) not in named]
    return [(i, j, number) for number, (i, j) in enumerate(given.tolist())] + [(i, j, -1) for i, j in others]


def _ordered(model: mujoco.MjModel, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " k"]) -> np.ndarray:
    """Both [k, 2], of the smaller type first."""
    swaps = model.geom_type[first] > model.geom_type[second]
    return np.stack([np.where(swaps, second, first), np.where(swaps, first, second)], axis=1)


def _may_meet(
    model: mujoco.MjModel, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " k"]
) -> Bool[np.ndarray, " k"]:
    """By their bits, and their bodies, which are in order: not of one body or of parent and child, as welded."""
    bits = model.geom_contype[first] & model.geom_conaffinity[second]
    bits |= model.geom_contype[second] & model.geom_conaffinity[first]
    bodies = model.geom_bodyid[first], model.geom_bodyid[second]
    one, other = (model.body_weldid[some] for some in bodies)
    above, above_other = (model.body_weldid[model.body_parentid[some]] for some in (one, other))
    found = (bits != 0) & (one != other) & ~np.isin((bodies[0] << 16) + bodies[1], model.exclude_signature)
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        found &= (one == 0) | (other == 0) | ((one != above_other) & (other != above))
    low, high = np.sort([model.geom_type[first], model.geom_type[second]], axis=0)
    return found & ((low != mujoco.mjtGeom.mjGEOM_PLANE) | (high > int(mujoco.mjtGeom.mjGEOM_HFIELD)))
