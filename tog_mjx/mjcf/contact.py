"""The penalty law of a contact, and the MJCF parameters with which MuJoCo obeys it.

MuJoCo's contact is soft. For a constraint row with inverse inertia A (an approximation fixed at compile time: the sum
of the translational `body_invweight0` of the two bodies), impedance d and reference acceleration a_ref, the regulariser
is R = A (1 - d) / d, and inside the friction cone the row's force is

    f = (a_ref - a) / R = d (a_ref - a) / (A (1 - d)),        a_ref = -B v - K d r,

with r the signed distance (negative in penetration), v its rate and a its acceleration (MuJoCo, Computation:
"Constraint model"; Modeling: "Solver parameters"). A `solref` of two negative numbers (-k, -b) sets K = k / d^2 and
B = b / d for an impedance d that does not depend on r. Then

    f = (-b v - k r - d a) / (A (1 - d))    ->    -(k / A) r - (b / A) v        as d -> 0:

a spring of stiffness k_c = k / A and a damper of d_c = b / A, blind to the acceleration and so to all other contacts.
The tangential rows have the same R (impratio 1) and no position term: `solreffriction` = (0, -b_f A) makes them
viscous, -b_f v_t. Outside the friction cone the solver minimises the same quadratic over the cone; with one R for all
rows of a contact that is the Euclidean projection of (f_n, f_t) onto |f_t| <= mu f_n. So the penalty law that MuJoCo
tends to is

    (f_n, f_t) = projection of (k_c pen - d_c v_n, -b_f v_t) onto the cone,  while pen > 0,

with an error of first order in d.

Symbols: pen = -r [m]; v_n, v_t normal and tangential speed of separation [m/s]; forces act on the second body [N].
"""

from typing import NamedTuple

import mujoco
import numpy as np

from tog_mjx.running.errors import InputError

MIN_IMPEDANCE = mujoco.mjMINIMP


class PenaltyLaw(NamedTuple):
    """A penalty contact: k_c [N/m], d_c [N s/m], mu [-], b_f [N s/m], c [s/m]. All fields are leaves of the pytree.

    `viscosity` (b_f) is the slope of the friction force over the tangential speed in the MuJoCo limit; `slope` (c) that
    of the friction *coefficient* in the paper's law, which sticks up to the speed psi_s = mu / c.
    """

    stiffness: float
    damping: float
    friction: float
    viscosity: float
    slope: float


class PairParameters(NamedTuple):
    """The contact attributes of an MJCF `<pair>`: solref [2], solimp [5], solreffriction [2], friction [5]."""

    solref: np.ndarray
    solimp: np.ndarray
    solreffriction: np.ndarray
    friction: np.ndarray


def inverse_weight(model: mujoco.MjModel, pair: int) -> float:
    """A [1/kg] of contact pair number `pair`: the summed translational inverse weight of its two bodies."""
    geoms = model.pair_geom1[pair], model.pair_geom2[pair]
    return float(sum(model.body_invweight0[model.geom_bodyid[geom], 0] for geom in geoms))


def to_mjcf(law: PenaltyLaw, inverse_weight: float, impedance: float = MIN_IMPEDANCE) -> PairParameters:
    """MJCF parameters of a pair that follows `law` up to first order in `impedance`.

    Args:
      law: the penalty law; its `slope` has no counterpart in MuJoCo and is not used.
      inverse_weight: A [1/kg], see `inverse_weight`.
      impedance: d, constant over the penetration; MuJoCo clips it to [1e-4, 0.9999].

    Raises:
      InputError: for an inverse weight that is not positive, or an impedance that MuJoCo would clip.
    """
    if not inverse_weight > 0:
        raise InputError(
            f"inverse_weight is {inverse_weight}: a contact needs a body that can move; give a positive number of 1/kg"
        )
    if not mujoco.mjMINIMP <= impedance <= mujoco.mjMAXIMP:
        raise InputError(
            f"impedance is {impedance}: MuJoCo clips it, so choose it from {mujoco.mjMINIMP} to {mujoco.mjMAXIMP}"
        )
    return PairParameters(
        solref=-inverse_weight * np.array([law.stiffness, law.damping]),
        solimp=np.array([impedance, impedance, 0.001, 0.5, 2.0]),
        solreffriction=-inverse_weight * np.array([0.0, law.viscosity]),
        friction=np.array([law.friction, law.friction, 0.0, 0.0, 0.0]),
    )


def from_mjcf(pair: PairParameters, inverse_weight: float) -> PenaltyLaw:
    """The penalty law that a pair tends to as its impedance goes to 0; the inverse of `to_mjcf`, with `slope` NaN.

    Both forms of `solref` are read: (-k, -b), and the standard (time constant t, damping ratio z), for which MuJoCo
    has k = 1 / (t z)^2 and b = 2 / t. A `solreffriction` of zeros means `solref`, as in MuJoCo.

    Raises:
      InputError: where no penalty law is the limit: an impedance that varies with the penetration, or a tangential
      spring.
    """
    solref, solimp = np.asarray(pair.solref, float), np.asarray(pair.solimp, float)
    if solimp[0] != solimp[1]:
        raise InputError(
            f"solimp is {solimp}: its impedance varies with the penetration; make its first two numbers equal"
        )
    stiffness, damping = _direct(solref)
    tangential = np.asarray(pair.solreffriction, float)
    tangential_stiffness, viscosity = _direct(tangential if tangential.any() else solref)
    if tangential.any() and tangential_stiffness != 0:
        raise InputError(f"solreffriction is {tangential}: write it as 0 -b, friction in a penalty law has no spring")
    scale = 1 / inverse_weight
    return PenaltyLaw(stiffness * scale, damping * scale, float(pair.friction[0]), viscosity * scale, float("nan"))


def _direct(solref: np.ndarray) -> tuple[float, float]:
    """(k, b) of a solref in either form."""
    first, second = float(solref[0]), float(solref[1])
    if first > 0 and second > 0:
        return 1 / (first * second) ** 2, 2 / first
    return -first, -second
