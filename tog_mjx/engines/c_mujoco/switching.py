"""What touch-downs and partings add to the derivative of a step of C MuJoCo: `stepping.saltation`, by its own solver.

A limit or a contact acts while its gap is negative. Those within the box of their switch (`stepping.touch`) are put at
the surface, and the solver is asked twice: H^-1 (sum over c of J_c^T f_c) is the acceleration with all of them minus
that without any. Of it each has a part, H^-1 J_c^T f_c with H of all other rows. Times -d(gap_c) / w_c that is what the
switch adds to the derivative of the acceleration, and the integrator says what the state makes of it. A gap depends on
positions alone, and moves with its normal's row of the Jacobian: d(gap_c) = n_c dq, in velocity space.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.converged import converged
from tog_mjx.stepping.touch import KICKS

TOUCHING = np.finfo(float).eps ** 0.75
"""How deep [m or rad] what touches just now is, as on MJX."""
REACH = 8.0
"""Half a box is at most so many times as wide as the way of the quickest body in a step, by speed and by acceleration:
two bodies move, friction may add as much as the normal force, and it is as wide as KICKS / 2 kicks."""
SIDE = 1e-4
"""Of a difference through the integrator, in velocity, in which it is linear but for what turns."""
_KIND = mujoco.mjtConstraint
_JOINT, _TENDON, _CONTACT, _ELLIPTIC = (
    int(kind)
    for kind in (
        _KIND.mjCNSTR_LIMIT_JOINT,
        _KIND.mjCNSTR_LIMIT_TENDON,
        _KIND.mjCNSTR_CONTACT_FRICTIONLESS,
        _KIND.mjCNSTR_CONTACT_ELLIPTIC,
    )
)
"""Kinds of rows; those of contacts are the last."""
_QUADRATIC, _CONE = (
    int(state)
    for state in (mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC, mujoco.mjtConstraintState.mjCNSTRSTATE_CONE)
)


class Rows(NamedTuple):
    """Constraint rows: J [nefc, nv], which are each switch's own [S, nefc], and the normals n [S, nv] of switches, with
    their regularisers D [S]."""

    jacobian: np.ndarray
    owns: np.ndarray
    normals: np.ndarray
    D: np.ndarray


class Jumps:
    """Room for the jumps of one step after the other: a model whose margins move, and its data. For one thread.

    The switches are all joints, all tendons, and the contacts in MuJoCo's order.
    """

    def __init__(self, forward: Forward):
        self.forward, self.model = forward, converged(forward.model)
        self.model.opt.noslip_iterations = 0
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND  # Rows change after they are found.
        self.data = mujoco.MjData(self.model)
        self._read()

    def _read(self) -> None:
        """What is asked of the model as it is given."""
        given = self.model
        self._limits = np.concatenate([given.jnt_margin, given.tendon_margin])
        self._gaps = {name: getattr(given, name).copy() for name in ("geom_gap", "pair_gap", "flex_gap", "body_margin")}
        self._extent = np.zeros(given.nbody)
        """Of each body: how far from its frame its geoms end."""
        np.maximum.at(self._extent, given.geom_bodyid, np.linalg.norm(given.geom_pos, axis=1) + given.geom_rbound)

    def of_step(
        self,
        before: Float[np.ndarray, " s"],
        after: Float[np.ndarray, " s"],
        controls: Float[np.ndarray, " nu"],
        held: Float[np.ndarray, " h"],
    ) -> Float[np.ndarray, "n nv"]:
        """What the switches add to the derivative of (qpos, qvel, act) after a step in the positions before it."""
        nv = self.model.nv
        jump = np.zeros((2 * nv + self.model.na, nv))
        # The next step's solver begins at the acceleration of this one.
        qacc = after[self.forward.ends[-1] :]
        self._reach(0.0, self._limits)
        self.forward.hold(self.data, held)
        if self.forward.layout.moves_model:
            self._read()
        self._begin(before, controls, qacc)
        gap = self._see(qacc)
        if np.isfinite(gap).any():
            width, normals = self._boxes(gap, qacc)
            near = (np.abs(gap) <= width / 2) & (width > 0)
            if near.any():
                for switch, part in zip(np.flatnonzero(near), self._parts(gap, near, qacc), strict=True):
                    slope = -normals[switch] / width[switch]
                    jump[: 2 * nv] += np.outer(self._integrated(before, qacc, part), slope)
        return jump

    def _begin(self, before: np.ndarray, controls: np.ndarray, qacc: np.ndarray) -> None:
        """The data of the state."""
        model, data = self.model, self.data
        mujoco.mj_setState(model, data, before, STATE)
        data.ctrl[:], data.qacc_warmstart[:] = controls, qacc
        for stage in (mujoco.mj_fwdPosition, mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation, mujoco.mj_fwdAcceleration):
            stage(model, data)

    def _reach(self, beyond: float, limits: Float[np.ndarray, " limits"]) -> None:
        """Contacts are seen from so far beyond their margins on, and limits within these margins."""
        for name, given in self._gaps.items():
            getattr(self.model, name)[:] = given + beyond
        self.model.jnt_margin[:], self.model.tendon_margin[:] = np.split(limits, [self.model.njnt])

    def _see(self, qacc: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " S"]:
        """How far each switch is from acting; infinitely if farther than a box reaches. Finds contacts anew."""
        model, data, dt = self.model, self.data, self.model.opt.timestep
        limits = self._limits + mujoco.mjMAXVAL  # How far a tendon goes in a step is not known: all are seen.
        limits[: model.njnt] = self._limits[: model.njnt] + REACH * (dt * abs(data.qvel) + dt**2 * abs(qacc)).max()
        qvel = data.qvel.copy()
        way = dt**2 * self._speed(qacc) + dt * self._speed(qvel)  # The data's own last, to leave all as it was.
        self._reach(REACH * way, limits)
        mujoco.mj_collision(model, data)
        mujoco.mj_makeConstraint(model, data)
        of_limits, switches = np.full(len(limits), np.inf), self._switches()
        rows = np.flatnonzero((switches >= 0) & (switches < len(limits)))
        np.minimum.at(of_limits, switches[rows], data.efc_pos[rows] - self._limits[switches[rows]])
        touching = data.contact
        self._margins, self._excluded = touching.includemargin.copy(), touching.exclude > 1
        of_contacts = np.where(self._excluded, np.inf, touching.dist - self._margins)
        return np.concatenate([of_limits, of_contacts])

    def _speed(self, qvel: Float[np.ndarray, " nv"]) -> float:
        """That of the quickest point of any geom [m/s]."""
        model, data = self.model, self.data
        data.qvel[:] = qvel
        mujoco.mj_comVel(model, data)
        turn, about = data.cvel[:, :3], data.xpos - data.subtree_com[model.body_rootid]
        along = data.cvel[:, 3:] + np.cross(turn, about)
        return float((np.linalg.norm(along, axis=1) + np.linalg.norm(turn, axis=1) * self._extent).max())

    def _switches(self) -> Int[np.ndarray, " nefc"]:
        """Whose each row is; -1 of those that belong to no switch."""
        kind, of = self.data.efc_type, self.data.efc_id
        joints, limits = self.model.njnt, self.model.njnt + self.model.ntendon
        return np.select([kind == _JOINT, kind == _TENDON, kind >= _CONTACT], [of, joints + of, limits + of], -1)

    def _rows(self, gap: Float[np.ndarray, " S"], surface: Bool[np.ndarray, " S"], out: Bool[np.ndarray, " S"]) -> Rows:
        """The rows with some switches as if they touched just now, some left out, and the others as they are."""
        model, data, limits = self.model, self.data, len(self._limits)
        margins = np.concatenate([self._limits, self._margins]) + np.where(surface, gap + TOUCHING, 0.0)
        margins[out] = -mujoco.mjMAXVAL
        self._reach(0.0, margins[:limits])
        data.contact.includemargin[:] = margins[limits:]
        is_void = out | ((gap >= 0) & ~surface)
        data.contact.exclude[:] = np.where(self._excluded, 2, is_void[limits:])
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_referenceConstraint(model, data)
        return self._found(len(gap))

    def _found(self, count: int) -> Rows:
        model, data = self.model, self.data
        jacobian = np.zeros((data.nefc, model.nv))
        if mujoco.mj_isSparse(model):
            pattern = data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
            mujoco.mju_sparse2dense(jacobian, data.efc_J, *pattern)
        else:
            jacobian[:] = data.efc_J.reshape(jacobian.shape)
        switches, kind = self._switches(), data.efc_type
        owns = np.arange(count)[:, None] == switches
        # Of an elliptic contact the first row, of a pyramidal one the mean of its edges.
        later = np.append(False, (switches[1:] == switches[:-1]) & (kind[1:] == _ELLIPTIC))
        of_normal = owns & ~later[: data.nefc]
        normals = of_normal @ jacobian / np.maximum(of_normal.sum(1), 1)[:, None]
        return Rows(jacobian, owns, normals, of_normal @ data.efc_D)

    def _boxes(
        self, gap: Float[np.ndarray, " S"], qacc: Float[np.ndarray, " nv"]
    ) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S nv"]]:
        """The widths of all boxes, zero of what is not seen, and the normals. See `stepping.saltation.effects`."""
        dt, is_open = self.model.opt.timestep, gap >= 0
        is_seen = np.isfinite(gap)
        rows = self._rows(gap, is_open & is_seen, ~is_seen)
        force = self._force(rows, qacc)
        pushed = np.zeros_like(rows.normals)
        mujoco.mj_solveM(self.model, self.data, pushed, rows.normals)
        kick = np.einsum("sr,rv,sv->s", rows.owns * force, rows.jacobian, pushed)
        # An open one is not in the solution yet, and would give way to its own force.
        yielding = np.einsum("sv,sv->s", rows.normals, pushed) * rows.D
        kick = np.where(is_open, kick / (1 + yielding), kick)
        travel = np.abs(rows.normals @ self.data.qvel) * dt
        return np.where(is_seen, np.maximum(travel, KICKS * np.abs(kick) * dt**2), 0.0), rows.normals

    def _force(self, rows: Rows, qacc: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " nefc"]:
        """The rows' forces at that acceleration; leaves their states in the data."""
        data = self.data
        mujoco.mj_constraintUpdate(self.model, data, rows.jacobian @ qacc - data.efc_aref, None, 1)
        return data.efc_force.copy()

    def _parts(
        self, gap: Float[np.ndarray, " S"], near: Bool[np.ndarray, " S"], qacc: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, "near nv"]:
        """Of the acceleration that all near switches make at the surface: the part of each."""
        data, nobody = self.data, np.zeros_like(near)
        with_all = self._rows(gap, near, nobody)
        qacc_with = self._solved(qacc)
        pulls = (with_all.owns[near] * data.efc_force) @ with_all.jacobian
        without = self._rows(gap, nobody, near)
        qacc_without = self._solved(qacc)
        total = qacc_with - qacc_without
        if near.sum() == 1:
            return total[None]
        self._force(without, qacc_without)
        parts = np.linalg.solve(self._hessian(without), pulls.T).T
        # What all have more than each by itself is shared out by their squares.
        squares = parts**2
        shares = squares / np.where(squares.sum(0) > 0, squares.sum(0), 1.0)
        return parts + np.where(squares.sum(0) > 0, shares, 1 / len(parts)) * (total - parts.sum(0))

    def _solved(self, qacc: Float[np.ndarray, " nv"]) -> Float[np.ndarray, " nv"]:
        self.data.qacc_warmstart[:] = qacc
        mujoco.mj_fwdConstraint(self.model, self.data)
        return self.data.qacc.copy()

    def _hessian(self, rows: Rows) -> Float[np.ndarray, "nv nv"]:
        """M - J^T (df/dx) J of rows whose states are in the data."""
        model, data = self.model, self.data
        hessian = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, hessian)
        stiffness = data.efc_D * (data.efc_state == _QUADRATIC)
        hessian += rows.jacobian.T @ (stiffness[:, None] * rows.jacobian)
        is_cone = (data.efc_type == _ELLIPTIC) & (data.efc_state == _CONE)
        for contact in np.unique(data.efc_id[is_cone]):
            own = rows.jacobian[is_cone & (data.efc_id == contact)]
            block = data.contact[contact].H[: len(own) ** 2].reshape(len(own), len(own))
            hessian += own.T @ block @ own
        return hessian

    def _integrated(
        self, before: np.ndarray, qacc: Float[np.ndarray, " nv"], part: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, " 2nv"]:
        """The derivative of the displacement and velocity after the step in the share of that part."""
        model, data, nv = self.model, self.data, self.model.nv
        size = SIDE / max(np.abs(part).max() * model.opt.timestep, np.finfo(float).tiny)
        is_euler = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
        ends = []
        for some in (qacc + size * part, qacc - size * part):
            mujoco.mj_setState(model, data, before, STATE)
            data.qacc[:], data.qfrc_constraint[:] = some, 0.0
            mujoco.mj_mulM(model, data, data.qfrc_smooth, some)
            (mujoco.mj_Euler if is_euler else mujoco.mj_implicit)(model, data)
            ends.append((data.qpos.copy(), data.qvel.copy()))
        (q_ahead, v_ahead), (q_behind, v_behind) = ends
        moved = np.zeros(nv)
        mujoco.mj_differentiatePos(model, moved, 2 * size, q_behind, q_ahead)
        return np.concatenate([moved, (v_ahead - v_behind) / (2 * size)])


def check_jumps(model: mujoco.MjModel, is_held: bool) -> None:
    """Raises InputError for derivatives in what is held, and for a model whose steps are not one solution and one
    advance."""
    if is_held:
        raise InputError("engine mujoco has no jumps in numbers of the model or mocap poses; take engine mjx for those")
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        told = "engine mujoco has no jumps of touch-downs with <option integrator='RK4'>"
        raise InputError(f"{told}; set Euler or implicitfast, or take engine mjx")
