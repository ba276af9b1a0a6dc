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
_DEGREES = 0.01
"""Between two directions that count as one."""
_CONE = "set cone='elliptic', which has no tangents"
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
    for stage in (_smooth, _contacts, _equalities, _rows, _friction, _solver):
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
    """Pairs of geoms whose contacts differ in their number or depths."""
    for name, mine, other in _touching(model, ours, theirs):
        if len(mine) != len(other):
            yield Apart(f"{name}: {len(mine)} points on MJX, {len(other)} on C MuJoCo", _COLLISIONS)
        elif _is_apart(depths := np.sort([point.depth for point in mine]), deeper := np.sort([p.depth for p in other])):
            yield Apart(f"{name}: {np.abs(depths - deeper).max():.2g} m in its depth", _COLLISIONS)


class _Point(NamedTuple):
    """Of a contact. The normal points from the geom of the lower number to the other."""

    depth: float
    position: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    friction: np.ndarray


def _touching(
    model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData
) -> Iterator[tuple[str, list[_Point], list[_Point]]]:
    """The contact of each pair of geoms, by its points on MJX and on C MuJoCo; without friction that has two zeros."""
    points: dict[tuple[int, ...], tuple[list[_Point], list[_Point]]] = {}

    def add(side: int, geoms: Any, depth: Any, position: Any, frame: Any, friction: Any) -> None:
        first, second = np.asarray(geoms).tolist()
        normal, *tangents = np.asarray(frame).reshape(3, 3)
        point = _Point(
            float(depth), np.asarray(position), normal if first < second else -normal, np.array(tangents), friction
        )
        points.setdefault((min(first, second), max(first, second)), ([], []))[side].append(point)

    watched = contacts(ours)
    friction = np.asarray(watched.friction)[:, :2] * (watched.condim[:, None] > 1)
    for i in np.flatnonzero(watched.distance < watched.margin):
        add(0, watched.geoms[i], watched.distance[i], watched.position[i], watched.frame[i], friction[i])
    for contact in theirs.contact:
        if not contact.exclude:
            add(1, contact.geom, contact.dist, contact.pos, contact.frame, contact.friction[:2] * (contact.dim > 1))
    for pair, (mine, other) in sorted(points.items(), key=lambda item: item[0]):
        yield f"the contact of {geoms_named(model, pair, ' with ')}", mine, other


def _geometry(model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    """Contacts of as many points that differ in where these are, in their normals, or in their tangents."""
    for name, mine, other in _touching(model, ours, theirs):
        for point in mine:
            there = min(other, key=lambda some: float(np.linalg.norm(some.position - point.position)))
            off = float(np.linalg.norm(there.position - point.position))
            tilt = np.degrees(np.arccos(np.clip(point.normal @ there.normal, -1, 1)))
            if off > APART:
                yield Apart(f"{name}: {off:.2g} m in its points", _COLLISIONS)
            elif tilt > _DEGREES:
                yield Apart(f"{name}: {tilt:.2g} degrees in its normal", _COLLISIONS)
            else:
                yield from _tangents(model, name, point, there)


def _tangents(model: mujoco.MjModel, name: str, mine: _Point, other: _Point) -> Iterator[Apart]:
    """Those of a pyramid whose sides are alike may change places, and those of a circular cone are any."""
    is_square, is_pyramid = np.ptp(mine.friction) == 0, model.opt.cone == mjx.ConeType.PYRAMIDAL
    if not mine.friction.any() or (is_square and not is_pyramid):
        return
    along, across = other.tangents @ mine.tangents[0]
    period = 90 if is_square else 180
    turned = abs((np.degrees(np.arctan2(across, along)) + period / 2) % period - period / 2)
    if turned > _DEGREES:
        remedy = _CONE if is_square else f"give both tangents the same friction; {_CONE}"
        yield Apart(f"{name}: {turned:.2g} degrees in the tangents that its friction depends on", remedy)


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
        ("contacts' parameters", _CONTACTS, "see 'preflight'"),
    )
    for (name, types, remedy), first, end in zip(groups, ends[:-1], ends[1:], strict=True):
        mine = jacobian[first:end], np.asarray(rows.D[first:end]), np.asarray(rows.reference[first:end])
        some = np.isin(theirs.efc_type, types)
        other = expected[some], theirs.efc_D[some], theirs.efc_aref[some]
        if any(map(_is_apart, _pull(*mine), _pull(*other))):
            if types is _CONTACTS:
                yield from _geometry(model, ours, theirs)
            yield Apart(f"its {name}", remedy)


def _friction(model: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    """Tangents of a pyramid: the sum over its edges does not depend on them, but what it allows does."""
    if _is_apart(ours.qacc, theirs.qacc):
        yield from (found for found in _geometry(model, ours, theirs) if found.remedy.endswith(_CONE))


def _pull(jacobian: np.ndarray, D: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return jacobian.T @ (D[:, None] * jacobian), jacobian.T @ (D * reference)


def _solver(_: mujoco.MjModel, ours: mjx.Data, theirs: mujoco.MjData) -> Iterator[Apart]:
    if _is_apart(ours.qacc, theirs.qacc):
        yield Apart("its solver's answer", "give both engines more iterations, of the line search too")
