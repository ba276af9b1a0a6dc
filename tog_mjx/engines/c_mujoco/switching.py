"""What touch-downs and partings add to the derivative of a step of C MuJoCo: `stepping.saltation`, by its own solver.

A limit or a contact acts while its gap is negative. Those within the box of their switch (`stepping.touch`) are put at
the surface, and the solver is asked twice: H^-1 (sum over c of J_c^T f_c) is the acceleration with all of them minus
that without any. Of it each has a part, H^-1 J_c^T f_c with H of all other rows. Times -d(gap_c) / w_c that is what the
switch adds to the derivative of the acceleration, and the integrator says what the state makes of it. A gap depends on
positions, and moves with its normal's row of the Jacobian, d(gap_c) = n_c dq, in velocity space; and on what is held,
see `gaps`.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.engines.c_mujoco.gaps import ELLIPTIC, Gaps
from tog_mjx.running.errors import InputError
from tog_mjx.stepping.touch import KICKS

TOUCHING = np.finfo(float).eps ** 0.75
"""How deep [m or rad] what touches just now is, as on MJX."""
SIDE = 1e-4
"""Of a difference through the integrator, in velocity, in which it is linear but for what turns."""
_QUADRATIC = int(mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC)
_CONE = int(mujoco.mjtConstraintState.mjCNSTRSTATE_CONE)


class Rows(NamedTuple):
    """Constraint rows: J [nefc, nv], which are each switch's own [S, nefc], and the normals n [S, nv] of switches, with
    their regularisers D [S]."""

    jacobian: np.ndarray
    owns: np.ndarray
    normals: np.ndarray
    D: np.ndarray


class Jumps:
    """Room for the jumps of one step after the other. For one thread."""

    def __init__(self, forward: Forward):
        self.forward, self.gaps = forward, Gaps(forward)
        self.model, self.data = self.gaps.model, self.gaps.data
        self.model.opt.noslip_iterations = 0
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND  # Rows change after they are found.

    def of_step(
        self,
        before: Float[np.ndarray, " s"],
        after: Float[np.ndarray, " s"],
        controls: Float[np.ndarray, " nu"],
        held: Float[np.ndarray, " h"],
        is_held: bool,
    ) -> Float[np.ndarray, "n d"]:
        """What the switches add to the derivative of (qpos, qvel, act) after a step in the positions before it and,
        with `is_held`, in the directions of what is held."""
        nv, ways = self.model.nv, self.forward.layout.directions if is_held else 0
        jump = np.zeros((2 * nv + self.model.na, nv + ways))
        # The next step's solver begins at the acceleration of this one.
        qacc = after[self.forward.ends[-1] :]
        self._begin(before, controls, held, qacc)
        reach = self.gaps.reach(qacc)
        gap = self.gaps.see(reach)
        if np.isfinite(gap).any():
            width, normals = self._boxes(gap, qacc)
            near = (np.abs(gap) <= width / 2) & (width > 0)
            if near.any():
                slopes = normals[near]
                if ways:
                    slopes = np.hstack([slopes, self.gaps.slopes(before, held, reach, gap, near)])
                slopes /= -width[near, None]
                for slope, part in zip(slopes, self._parts(gap, near, qacc), strict=True):
                    jump[: 2 * nv] += np.outer(self._integrated(before, qacc, part), slope)
        return jump

    def _begin(self, before: np.ndarray, controls: np.ndarray, held: np.ndarray, qacc: np.ndarray) -> None:
        """The data of the state."""
        model, data = self.model, self.data
        self.gaps.begin(before, held)
        data.ctrl[:], data.qacc_warmstart[:] = controls, qacc
        for stage in (mujoco.mj_fwdPosition, mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation, mujoco.mj_fwdAcceleration):
            stage(model, data)

    def _rows(self, gap: np.ndarray, surface: np.ndarray, out: np.ndarray) -> Rows:
        """The rows with some switches [S] as if they touched just now, some left out, and the others as they are."""
        model, data, limits = self.model, self.data, len(self.gaps.limits)
        margins = np.concatenate([self.gaps.limits, self.gaps.margins]) + np.where(surface, gap + TOUCHING, 0.0)
        margins[out] = -mujoco.mjMAXVAL
        self.gaps.limit(margins[:limits])
        data.contact.includemargin[:] = margins[limits:]
        is_void = out | ((gap >= 0) & ~surface)
        data.contact.exclude[:] = np.where(self.gaps.excluded, 2, is_void[limits:])
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_referenceConstraint(model, data)
        return self._found(len(gap))

    def _found(self, count: int) -> Rows:
        model, data = self.model, self.data
        if mujoco.mj_isSparse(model):
            jacobian = np.zeros((data.nefc, model.nv))
            pattern = data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
            mujoco.mju_sparse2dense(jacobian, data.efc_J, *pattern)
        else:
            jacobian = data.efc_J.reshape(data.nefc, model.nv).copy()
        switches = self.gaps.switches()
        owns = (np.arange(count)[:, None] == switches).astype(float)
        # Of an elliptic contact the first row, of a pyramidal one the mean of its edges.
        of_normal = owns.copy()
        of_normal[:, 1:] *= (switches[1:] != switches[:-1]) | (data.efc_type[1:] != ELLIPTIC)
        normals = of_normal @ jacobian / np.maximum(of_normal.sum(1), 1.0)[:, None]
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
        kick = ((rows.owns * force) @ rows.jacobian * pushed).sum(1)
        # An open one is not in the solution yet, and would give way to its own force.
        kick[is_open] /= 1 + ((rows.normals * pushed).sum(1) * rows.D)[is_open]
        travel = np.abs(rows.normals @ self.data.qvel) * dt
        return np.where(is_seen, np.maximum(travel, KICKS * np.abs(kick) * dt**2), 0.0), rows.normals

    def _force(self, rows: Rows, qacc: np.ndarray) -> np.ndarray:
        """The rows' forces [nefc] at that acceleration; leaves their states in the data."""
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

    def _solved(self, qacc: np.ndarray) -> np.ndarray:
        """The acceleration under the rows in the data, from one that is near."""
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
        is_cone = (data.efc_type == ELLIPTIC) & (data.efc_state == _CONE)
        for contact in np.unique(data.efc_id[is_cone]):
            own = rows.jacobian[is_cone & (data.efc_id == contact)]
            block = data.contact[contact].H[: len(own) ** 2].reshape(len(own), len(own))
            hessian += own.T @ block @ own
        return hessian

    def _integrated(
        self, before: np.ndarray, qacc: Float[np.ndarray, " nv"], part: Float[np.ndarray, " nv"]
    ) -> Float[np.ndarray, " 2*nv"]:
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


def check_jumps(model: mujoco.MjModel) -> None:
    """Raises InputError for a model whose steps are not one solution and one advance."""
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        told = "engine mujoco has no jumps with <option integrator='RK4'>: contacts switch in all four stages of a step"
        raise InputError(f"{told}; set Euler or implicitfast, or take engine mjx")
