"""Numbers of a model that nothing reads in any state: the mass of what never moves, the friction that `condim` leaves
out, the contact parameters of what never touches. That their derivatives are zero is no fault."""

import mujoco
import numpy as np
from jaxtyping import Bool

from tog_mjx.mjcf.supported import candidates

_OF_MASSES = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_gravcomp")
_OF_LIMITS = {"jnt_range": "jnt_limited", "tendon_range": "tendon_limited"}
_OF_CONTACTS = ("geom_solref", "geom_solimp", "geom_solmix", "geom_margin", "geom_gap")
_FRICTIONS = {1: 0, 3: 1, 4: 2, 6: 3}
"""By condim, how many of sliding, spinning and rolling friction a contact reads."""
_PAIR_FRICTIONS = {1: 0, 3: 2, 4: 3, 6: 5}
"""As `_FRICTIONS`, of the five numbers of a <pair>: sliding and rolling have two directions."""


def unused(model: mujoco.MjModel, array: str) -> Bool[np.ndarray, "..."]:
    """Which numbers of a field nothing reads, in its shape; a single False where none is known."""
    if array in _OF_MASSES:
        read = np.ones(getattr(model, array).shape, bool)
        read[model.body_weldid == 0] = False
    elif array in _OF_LIMITS:
        read = np.ones(getattr(model, array).shape, bool)
        read[getattr(model, _OF_LIMITS[array]) == 0] = False
    elif array == "pair_friction":
        numbers = np.array([_PAIR_FRICTIONS[int(condim)] for condim in model.pair_dim], int)
        read = np.arange(5) < numbers[:, None]
    elif array == "geom_friction" or array in _OF_CONTACTS:
        read = np.zeros(getattr(model, array).shape, bool)
        for first, second, pair in candidates(model):
            if pair >= 0:  # It has numbers of its own.
                continue
            geoms = np.array([first, second])
            if not array.endswith(("margin", "gap")):  # Of both geoms, whichever has priority.
                geoms = geoms[model.geom_priority[geoms] == model.geom_priority[geoms].max()]
            if array == "geom_friction":
                read[geoms, : frictions(model, first, second)] = True
            else:
                read[geoms] = True
    else:
        read = np.ones((), bool)
    return np.asarray(~read)


def frictions(model: mujoco.MjModel, first: int, second: int) -> int:
    """How many of the three friction numbers of two geoms their contact reads: the larger condim counts, or that of the
    higher priority."""
    geoms = np.array([first, second])
    priority, condim = model.geom_priority[geoms], model.geom_condim[geoms]
    return _FRICTIONS[int(condim[priority == priority.max()].max())]
