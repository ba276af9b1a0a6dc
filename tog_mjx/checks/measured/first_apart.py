"""Where in a step MJX and C MuJoCo part: the first of its stages that differs at one state."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np

from tog_mjx.checks.file.spoilers import EQUALITY_REMEDY
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.mjcf.supported import geoms_named, name_of
from tog_mjx.stepping._mjx import constraint_rows, contacts, mjx, put_model
from tog_mjx.stepping.mjx_state import copy_of, on_mjx

APART = 1e-4
"""Of the size of what is compared: more than rounding, and than what two converged solvers leave."""
_COLLISIONS = "MJX's collisions are its own for some geoms: build them of spheres and capsules"
_FORCES = {"qfrc_bias": "bias forces", "qfrc_passive": "passive forces", "qfrc_actuator": "actuator forces"}
_CONTACTS = (
    mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS,
    mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL,
    mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC,
)
_ROWS = {
    mujoco.mjtEq.mjEQ_CONNECT: 3,
    mujoco.mjtEq.mjEQ_WELD: 6,
    mujoco.mjtEq.mjEQ_JOINT: 1,
    mujoco.mjtEq.mjEQ_TENDON: 1,
}
"""Of an equality, in the order in which MJX has their types."""


class Apart(NamedTuple):
    """The stage of a step, told with its elements and numbers, and the remedy."""

    what: str
    remedy: str


def first_apart(model: mujoco.MjModel, state: mujoco.MjData) -> Apart | None:
    """The first stage that differs at a state, which is left as it is; None if none does."""
    theirs = copy_of(model, state)
    mujoco.mj_forward(model, theirs)
    mjx_model = put_model(model)
    ours = compile_quickly(mjx.forward)(mjx_model, on_mjx(mjx_model, state))
    for stage in (_smooth, _contacts, _equalities, _rows, _solver):
        if found := next(stage(model, ours, theirs), None):
            return found
    return None


def _is_apart(a: Any, b: Any, size: float = 0.0) -> bool:
    a, b = np.asarray(a), np.asarray(b)
    sizes = size, float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return bool(np.linalg.norm(a - b) > APART * max(sizes))


def _smooth(_: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    for field, size in (("xpos", 1.0), ("xquat", 1.0), ("ten_length", 1.0), ("actuator_length", 1.0)):
        if _is_apart(getattr(ours, field), getattr(theirs, field), size):
            yield Apart(f"its kinematics ({field})", "see 'preflight'")
    size = sum(float(np.linalg.norm(getattr(theirs, field))) for field in _FORCES)
    for field, name in _FORCES.items():
        if _is_apart(getattr(ours, field), getattr(theirs, field), size):
            yield Apart(f"its {name}", "see 'preflight'")
    if _is_apart(ours.qacc_smooth, theirs.qacc_smooth):
        yield Apart("its inertia", "see 'preflight'")


def _contacts(model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    """Pairs of geoms whose contacts differ: in their number, in their depths, or in what they do to the joints."""
    touching = contacts(ours)
    acts = np.asarray(touching.distance < touching.margin)
    pairs = [tuple(sorted(pair)) for pair in np.asarray(touching.geoms).tolist()]
    acting = [contact for contact in theirs.contact if not contact.exclude]
    others = [tuple(sorted(contact.geom.tolist())) for contact in acting]
    for pair in sorted({pair for pair, act in zip(pairs, acts, strict=True) if act} | set(others)):
        names = geoms_named(model, pair, " with ")
        mine = np.sort(np.asarray(touching.distance)[acts & np.array([some == pair for some in pairs])])
        other = np.sort([contact.dist for contact, some in zip(acting, others, strict=True) if some == pair])
        if mine.size != other.size:
            yield Apart(f"the contact of {names}: {mine.size} points on MJX, {other.size} on C MuJoCo", _COLLISIONS)
        elif _is_apart(mine, other):
            yield Apart(f"the contact of {names}: {np.abs(mine - other).max():.2g} m in its depth", _COLLISIONS)


def _equalities(model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    rows, first = constraint_rows(ours), 0
    size = float(np.linalg.norm(theirs.qacc_smooth))
    for kind, count in _ROWS.items():
        for i in np.flatnonzero(model.eq_type == kind).tolist() if rows.equalities else ():
            at = slice(first, first := first + count)
            other = (theirs.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (theirs.efc_id == i)
            if not other.any():  # Not active.
                continue
            name = f"equality {name_of(model, 'equality', i)}"
            reference, expected = np.asarray(rows.reference[at]), theirs.efc_aref[other]
            if _is_apart(np.asarray(rows.D[at]), theirs.efc_D[other]):
                yield Apart(f"the regulariser of {name}", "see 'preflight'")
            elif _is_apart(reference, expected, size):
                off = f"{np.abs(reference - expected).max():.2g}"
                what = f"the reference acceleration of {name}, by {off} m/s^2 or rad/s^2"
                if count > 1:
                    what += ": MJX leaves out the part that grows with the square of the angular speed"
                yield Apart(what, EQUALITY_REMEDY)


def _rows(model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    """Friction losses, limits and contacts by what they do to the joints: J^T D J and J^T D a_ref, summed up."""
    rows, kinds = constraint_rows(ours), mujoco.mjtConstraint
    is_elliptic = model.opt.cone == mjx.ConeType.ELLIPTIC
    sizes = [1 if dim == 1 else dim if is_elliptic else 2 * (dim - 1) for dim in contacts(ours).condim.tolist()]
    ends = rows.equalities, rows.equalities + rows.losses, rows.D.size - sum(sizes), rows.D.size
    jacobian = np.asarray(rows.jacobian)
    expected = np.zeros((theirs.nefc, model.nv))
    if mujoco.mj_isSparse(model) and theirs.nefc:
        structure = theirs.efc_J_rownnz, theirs.efc_J_rowadr, theirs.efc_J_colind
        mujoco.mju_sparse2dense(expected, theirs.efc_J, *structure)
    else:
        expected = theirs.efc_J.reshape(expected.shape)
    groups = (
        ("friction losses", (kinds.mjCNSTR_FRICTION_DOF, kinds.mjCNSTR_FRICTION_TENDON), "see 'preflight'"),
        ("limits", (kinds.mjCNSTR_LIMIT_JOINT, kinds.mjCNSTR_LIMIT_TENDON), "see 'preflight'"),
        ("contacts' points or directions", _CONTACTS, _COLLISIONS),
    )
    for (name, types, remedy), first, end in zip(groups, ends[:-1], ends[1:], strict=True):
        mine = jacobian[first:end], np.asarray(rows.D[first:end]), np.asarray(rows.reference[first:end])
        some = np.isin(theirs.efc_type, types)
        other = expected[some], theirs.efc_D[some], theirs.efc_aref[some]
        if any(map(_is_apart, _pull(*mine), _pull(*other))):
            yield Apart(f"its {name}", remedy)


def _pull(jacobian: np.ndarray, D: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return jacobian.T @ (D[:, None] * jacobian), jacobian.T @ (D * reference)


def _solver(_: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    if _is_apart(ours.qacc, theirs.qacc):
        yield Apart("its solver's answer", "give both engines more iterations, of the line search too")
