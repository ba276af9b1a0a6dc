"""How far limits and contacts of C MuJoCo are from acting, and how that moves with what is held.

A size, the place of a body or joint, a margin, a range or a mocap pose moves a gap, which is found by differences of
the gaps alone; a mass or a friction does not.
"""

import functools
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from tog_mjx.engines.c_mujoco.forward import STATE, WARNED, Forward
from tog_mjx.stepping.converged import converged

REACH = 8.0
"""Half a box is at most so many times as wide as the way of the quickest body in a step, by speed and by acceleration:
two bodies move, friction may add as much as the normal force, and it is as wide as KICKS / 2 kicks."""
STEP = 1e-6
"""Of a difference of gaps, in each direction's unit."""
FARTHER = 1e-3
"""How much farther [m or rad] a gap is seen from where such a difference may have moved it."""
ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
STILL = frozenset(
    {f"body_{name}" for name in ("mass", "inertia", "ipos", "iquat", "subtreemass", "invweight0")}
    | {f"dof_{name}" for name in ("armature", "damping", "frictionloss", "solref", "solimp", "invweight0", "M0")}
    | {f"geom_{name}" for name in ("friction", "solref", "solimp", "solmix")}
    | {f"jnt_{name}" for name in ("stiffness", "solref", "solimp")}
    | {f"tendon_{name}" for name in ("stiffness", "damping", "frictionloss", "armature", "invweight0")}
    | {f"actuator_{name}" for name in ("gear", "gainprm", "biasprm", "dynprm", "acc0", "length0")}
    | {f"opt.{name}" for name in ("timestep", "gravity", "density", "viscosity", "wind")}
)
"""Fields of the model that move no gap: their differences are not taken."""
_CONTACT = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
"""Rows of this kind and of those after it are of contacts."""


class Reach(NamedTuple):
    """How far from acting limits of joints [m or rad] and contacts [m] are seen."""

    joints: float
    contacts: float


class Gaps:
    """Room to see the gaps of one state after the other: a model whose margins move, and its data. For one thread.

    The switches are all joints, all tendons, and the contacts in MuJoCo's order.
    """

    def __init__(self, forward: Forward):
        self.forward, self.model = forward, converged(forward.model)
        self.data = mujoco.MjData(self.model)
        for kind in self.data.warning:
            kind.number = WARNED
        limits = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT), int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON)
        self._first = np.full(ELLIPTIC + 1, -1)
        """Of each kind of rows: its first switch, or -1 if they belong to none."""
        self._first[[*limits, _CONTACT]] = 0, self.model.njnt, self.model.njnt + self.model.ntendon
        self._first[_CONTACT:] = self._first[_CONTACT]
        self._held: np.ndarray | None = None
        self._read()

    def _read(self) -> None:
        """What is asked of the model as it is given."""
        given = self.model
        self.limits = np.concatenate([given.jnt_margin, given.tendon_margin])
        gaps = given.geom_gap, given.pair_gap, given.flex_gap, given.body_margin
        self._gaps = [(gap, gap.copy()) for gap in gaps if gap.size]
        self._extent = np.zeros(given.nbody)
        """Of each body: how far from its frame its geoms end."""
        np.maximum.at(self._extent, given.geom_bodyid, np.linalg.norm(given.geom_pos, axis=1) + given.geom_rbound)

    def begin(self, state: Float[np.ndarray, " s"], held: Float[np.ndarray, " h"]) -> None:
        """Puts a state and what is held into the data and their model, and margins back."""
        self._see_beyond(0.0)
        self.limit(self.limits)
        if self._held is None or (held != self._held).any():
            self.forward.hold(self.data, held)
            self._held = held.copy()
            self._read()
        mujoco.mj_setState(self.model, self.data, state, STATE)

    def _see_beyond(self, margins: float) -> None:
        """Contacts are seen from so far beyond their margins on."""
        for here, given in self._gaps:
            here[:] = given + margins

    def limit(self, margins: np.ndarray) -> None:
        """Limits [njnt + ntendon] have rows within these margins."""
        joints = self.model.njnt
        self.model.jnt_margin[:], self.model.tendon_margin[:] = margins[:joints], margins[joints:]

    def reach(self, qacc: Float[np.ndarray, " nv"]) -> Reach:
        """In which all boxes lie at that acceleration, with positions and velocities known."""
        data, dt = self.data, self.model.opt.timestep
        joints = (dt * abs(data.qvel) + dt**2 * abs(qacc)).max()
        return Reach(REACH * joints, REACH * self._way(qacc))

    def see(self, reach: Reach) -> Float[np.ndarray, " S"]:
        """How far each switch is from acting; infinitely if farther than that. Finds contacts anew, and their own
        `margins` and which are `excluded` from acting; positions are known."""
        model, data = self.model, self.data
        limits = self.limits + mujoco.mjMAXVAL  # How far a tendon goes in a step is not known: all are seen.
        limits[: model.njnt] = self.limits[: model.njnt] + reach.joints
        self.limit(limits)
        self._see_beyond(reach.contacts)
        mujoco.mj_collision(model, data)
        mujoco.mj_makeConstraint(model, data)
        of_limits, switches = np.full(len(limits), np.inf), self.switches()
        rows = np.flatnonzero((switches >= 0) & (switches < len(limits)))
        np.minimum.at(of_limits, switches[rows], data.efc_pos[rows] - self.limits[switches[rows]])
        touching = data.contact
        self.margins, self.excluded = touching.includemargin.copy(), touching.exclude > 1
        of_contacts = np.where(self.excluded, np.inf, touching.dist - self.margins)
        return np.concatenate([of_limits, of_contacts])

    def _way(self, qacc: np.ndarray) -> float:
        """How far [m] the quickest point of any geom goes in a step, by its speed and by its acceleration."""
        model, data, dt, way = self.model, self.data, self.model.opt.timestep, 0.0
        arms = self._extent + np.linalg.norm(data.xpos - data.subtree_com[model.body_rootid], axis=1)
        for qvel, duration in ((qacc, dt**2), (data.qvel.copy(), dt)):  # The data's own last, to leave all as it was.
            data.qvel[:] = qvel
            mujoco.mj_comVel(model, data)
            turn, along = np.sqrt((data.cvel.reshape(-1, 2, 3) ** 2).sum(2)).T
            way += duration * float((along + turn * arms).max())
        return way

    def switches(self) -> np.ndarray:
        """Whose each row is, [nefc]; -1 if nobody's."""
        first = self._first[self.data.efc_type]
        return np.where(first < 0, -1, first + self.data.efc_id)

    @functools.cached_property
    def _moving(self) -> Int[np.ndarray, " k"]:
        """The directions of what is held that may move a gap."""
        layout = self.forward.layout
        may = np.arange(layout.directions) >= len(layout.size)
        for name, rate in layout.rates.items():
            if name not in STILL:
                may[: len(layout.size)] |= rate.any(0)
        return np.flatnonzero(may)

    @functools.cached_property
    def _displaced(self) -> "Gaps":
        """Room to see them where something else is held: there the next state would have to have all put back."""
        return Gaps(self.forward)

    def slopes(
        self,
        state: Float[np.ndarray, " s"],
        held: Float[np.ndarray, " h"],
        reach: Reach,
        gap: Float[np.ndarray, " S"],
        chosen: Bool[np.ndarray, " S"],
    ) -> Float[np.ndarray, "chosen d"]:
        """The derivatives of some gaps that are seen, in the directions of what is held."""
        found = np.zeros((chosen.sum(), self.forward.layout.directions))
        if not self._moving.size:
            return found
        along, other, gaps = np.eye(found.shape[1])[self._moving], self._displaced, []
        reach = Reach(*(some + FARTHER for some in reach))
        for row in self.forward.layout.displaced(held[None], STEP * np.concatenate([along, -along]))[0]:
            other.begin(state, row)
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_flex, mujoco.mj_tendon):
                stage(other.model, other.data)
            gaps.append(self._matched(other, other.see(reach), gap)[chosen])
        ahead, behind = np.split(np.array(gaps), 2)
        found[:, self._moving] = ((ahead - behind) / (2 * STEP)).T
        return found

    def _matched(self, other: "Gaps", displaced: Float[np.ndarray, " S2"], gap: np.ndarray) -> Float[np.ndarray, " S"]:
        """The other's gaps in the order of one's own, of which there may be more or fewer: of each contact that of the
        same two, nearest to it. What is not seen there has not moved."""
        limits, own, theirs = len(self.limits), self.data.contact, other.data.contact
        found = gap.copy()
        found[:limits] = displaced[:limits]
        pairs, others = (np.hstack([some.geom, some.flex, some.elem, some.vert]) for some in (own, theirs))
        if len(others):
            apart = np.linalg.norm(own.pos[:, None] - theirs.pos, axis=2)
            apart[(pairs[:, None] != others).any(2)] = np.inf
            nearest = apart.argmin(1)
            is_seen = np.isfinite(apart.min(1))
            found[limits:][is_seen] = displaced[limits + nearest[is_seen]]
        return found
