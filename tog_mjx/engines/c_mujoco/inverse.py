"""The derivative of smooth steps from inverse dynamics, in which no difference asks the solver.

A step of length dt from (q, v) to (q+, v+) obeys f(q, v, a) = tau(u) with a = (v+ - v) / dt: f is the inverse of the
integrator's step, in which constraint forces are known with a, and tau what controls add to the actuators' forces. So
df/da da = dtau/du du - df/dq dq - df/dv dv, then dv+ = dv + dt da, and positions follow v+.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from tog_mjx.engines.c_mujoco.forward import STATE, Forward
from tog_mjx.engines.c_mujoco.one_step import Given
from tog_mjx.engines.c_mujoco.threads import for_each

STEP = 1e-7
"""Of differences in q and v, in each coordinate's unit. There is no solver's rounding; but where the acceleration stays
a contact has larger higher derivatives. Of ant, cheetah and walker the means err by 5e-6 of 150 at most; those of
`mjd_transitionFD`, with a step of 1e-6, by 5e-5."""
STEP_IN_CONTROLS = 1e-6
STEP_IN_A = 1e-4
"""In a, which is what STEP makes of a contact's reference acceleration."""
LARGE = 8
"""From so many degrees of freedom on it takes less time than `mjd_transitionFD` where there are constraints."""
ITERATIONS = 20
"""A solver of fewer may stop short at any step, and the motion is then that of its iterations, not of its solution."""
DAMPED = 100
"""The largest share of dt damping in the inertia that is differenced. Inverse dynamics undoes the integrator's, so that
a step in a is as many times larger in the acceleration that contacts and limits see."""
_EULER = int(mujoco.mjtIntegrator.mjINT_EULER)  # To compare an enumerator itself takes as long as a small step.
_INTEGRATORS = _EULER, int(mujoco.mjtIntegrator.mjINT_IMPLICIT), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
_FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
_ELLIPTIC = int(mujoco.mjtCone.mjCONE_ELLIPTIC)
_TURNING = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}
"""Joints that turn in three ways, and the first of those among their velocities."""


def is_for(forward: Forward) -> bool:
    """Whether it saves time, and f and tau are all that there is: no activations, no forces in space, whose moments
    turn with bodies, no limits of what several actuators do together, nothing that changes forces after the solver,
    a solver that is given time, no implicit integrator whose damping may follow controls, and none that is all."""
    model = forward.model
    is_damped = model.opt.integrator != _EULER and (model.actuator_gaintype != _FIXED).any()
    if model.nv < LARGE or model.opt.integrator not in _INTEGRATORS or is_damped or model.opt.iterations < ITERATIONS:
        return False
    with forward.data() as data:
        is_pushed = data.xfrc_applied.any() or _damping(model, data, forward.start) > DAMPED
    beside = model.na, model.nflex, model.nplugin, model.opt.noslip_iterations, is_pushed
    limits = model.jnt_actfrclimited.any(), model.tendon_actfrclimited.any()
    is_penalised = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_IPC
    return not any((*beside, *limits, is_penalised))


def _damping(model: mujoco.MjModel, data: mujoco.MjData, state: Float[np.ndarray, " s"]) -> float:
    """The largest share of dt damping in the inertia that any velocity has, as the integrator takes it."""
    inertia, damping = np.empty((2, model.nv, model.nv))
    mujoco.mj_setState(model, data, state, STATE)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    if model.opt.integrator == _EULER:
        damping = np.diag(model.dof_damping)
    else:
        mujoco.mj_implicit(model, data)
        mujoco.mju_sparse2dense(damping, data.qDeriv, model.D_rownnz, model.D_rowadr, model.D_colind)
    return float((model.opt.timestep * np.abs(np.diag(damping)) / np.diag(inertia)).max())


class _Found(NamedTuple):
    """Of N steps: which are done, dt, v+ [N, nv], and the transposed derivatives of f in q, v and a, ahead and behind,
    [2, N, nv, nv], of a only ahead where f is linear between kinks; and of actuators their limits [N, nu, 2], moments
    [N, nu, nv], and forces at the controls, ahead, and behind [3, N, nu]."""

    done: np.ndarray
    dt: np.ndarray
    qvel: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    limits: np.ndarray
    moments: np.ndarray
    forces: np.ndarray

    @classmethod
    def room(cls, model: mujoco.MjModel, count: int) -> "_Found":
        nv, nu = model.nv, model.nu
        q, v, a = np.tile(np.eye(nv), (3, 2, count, 1, 1))
        a = a if model.opt.cone == _ELLIPTIC else a[:1]
        limits, moments, forces = np.zeros((count, nu, 2)), np.zeros((count, nu, nv)), np.zeros((3, count, nu))
        done, dt, qvel = np.zeros(count, bool), np.ones(count), np.zeros((count, nv))
        return cls(done, dt, qvel, q, v, a, limits, moments, forces)

    def of(self, steps: Bool[np.ndarray, " N"]) -> "_Found":
        """Of some steps alone."""
        q, v, a, forces = (some[:, steps] for some in (self.q, self.v, self.a, self.forces))
        done, dt, qvel, limits, moments = (
            some[steps] for some in (self.done, self.dt, self.qvel, self.limits, self.moments)
        )
        return _Found(done, dt, qvel, q, v, a, limits, moments, forces)


def transitions(
    forward: Forward, given: Given, after: Float[np.ndarray, "N s"]
) -> tuple[Float[np.ndarray, "2 N r m"], Bool[np.ndarray, " N"]]:
    """Derivatives of (time, qpos, qvel) ahead and behind, in velocity space, in (qpos, qvel, ctrl), and of which steps
    they are: of those with constraints that the solver solves, beginning at the acceleration in `after`. For a model
    that `is_for`."""
    model, (_, controls, held) = forward.model, given
    room = _Found.room(model, len(after))
    for_each(forward, held, lambda data, i: _differentiate(forward, data, given, after, i, room))
    slopes = np.zeros((2, len(after), 1 + 2 * model.nv, 2 * model.nv + model.nu))
    if room.done.any():
        slopes[:, room.done, 1:] = _solved(model, controls[room.done], room.of(room.done))
    return slopes, room.done


def _solved(
    model: mujoco.MjModel, controls: Float[np.ndarray, "N nu"], found: "_Found"
) -> Float[np.ndarray, "2 N n m"]:
    """Of (qpos, qvel), from what is found of f and tau."""
    tau = _slopes_of_forces(model, controls, found)[..., None] * found.moments
    forces, dt = np.concatenate([-found.q, -found.v, tau], axis=2).swapaxes(2, 3), found.dt[:, None, None]
    speeds = dt * (np.linalg.inv(found.a.swapaxes(2, 3)) @ forces)
    speeds[..., model.nv : 2 * model.nv] += np.eye(model.nv)
    of_q, of_way = _places(model, found)
    places = of_way @ (dt * speeds)
    places[..., : model.nv] += of_q
    return np.concatenate([places, speeds], axis=2)


def _differentiate(
    forward: Forward, data: mujoco.MjData, given: Given, after: np.ndarray, i: int, found: _Found
) -> None:
    """One of the steps."""
    model, (states, controls, _), dt = data.model, given, data.model.opt.timestep
    _begin(data, states[i], controls[i])
    qvel = data.qvel.copy()
    data.qacc_warmstart[:], data.solver_niter[:] = after[i, forward.ends[-1] :], 0
    mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, True)
    found.done[i] = data.nefc and max(data.solver_niter.tolist()) < model.opt.iterations
    if not found.done[i]:
        return
    (mujoco.mj_Euler if model.opt.integrator == _EULER else mujoco.mj_implicit)(model, data)
    found.dt[i], found.qvel[i] = dt, data.qvel
    _drive(data, controls[i], found.limits[i], found.moments[i], found.forces[:, i])
    _begin(data, states[i], controls[i])
    data.qacc[:] = (found.qvel[i] - qvel) / dt
    unasked = None, None, None, None
    for side, sign in enumerate((1, -1)):
        mujoco.mjd_inverseFD(model, data, sign * STEP, True, found.q[side, i], found.v[side, i], None, *unasked)
        if side < len(found.a):
            mujoco.mjd_inverseFD(model, data, sign * STEP_IN_A, False, None, None, found.a[side, i], *unasked)


def _begin(data: mujoco.MjData, state: Float[np.ndarray, " s"], controls: Float[np.ndarray, " nu"]) -> None:
    mujoco.mj_setState(data.model, data, state, STATE)
    data.ctrl[:] = controls


def _drive(
    data: mujoco.MjData, controls: np.ndarray, limits: np.ndarray, moment: np.ndarray, forces: np.ndarray
) -> None:
    """What is found of actuators in such data. The force of each depends on its own control alone: all move at once."""
    limits[:], forces[0] = data.model.actuator_ctrlrange, data.actuator_force
    pattern = data.moment_rownnz, data.moment_rowadr, data.moment_colind
    mujoco.mju_sparse2dense(moment, data.actuator_moment, *pattern)
    for side, step in ((1, STEP_IN_CONTROLS), (2, -STEP_IN_CONTROLS)):
        data.ctrl[:] = controls + step
        mujoco.mj_fwdActuation(data.model, data)
        forces[side] = data.actuator_force


def _slopes_of_forces(
    model: mujoco.MjModel, controls: Float[np.ndarray, "N nu"], found: _Found
) -> Float[np.ndarray, "2 N nu"]:
    """Those of actuators in their controls, ahead and behind; at a limit both inward, and beyond it none, as
    `mjd_transitionFD` has it."""
    low, high = np.where(model.actuator_ctrllimited[:, None], found.limits, [-np.inf, np.inf]).transpose(2, 0, 1)
    steps = np.array([STEP_IN_CONTROLS, -STEP_IN_CONTROLS])[:, None, None]
    slopes, ends = (found.forces[1:] - found.forces[0]) / steps, controls + steps
    can = (low <= ends) & (ends <= high)
    return np.where(can, slopes, np.where(can[::-1], slopes[::-1], 0.0))


def _places(model: mujoco.MjModel, found: _Found) -> Float[np.ndarray, "2 N nv nv"]:
    """The derivatives of q+ in q and in dt v+, which are no identities where bodies turn."""
    places, unasked = np.tile(np.eye(model.nv), (2, len(found.dt), 1, 1)), np.empty(3)
    for kind, first in zip(model.jnt_type, model.jnt_dofadr, strict=True):
        if kind in _TURNING:
            turns = slice(first + _TURNING[kind], first + _TURNING[kind] + 3)
            for i, dt in enumerate(found.dt):
                of_q, of_way = np.empty((2, 9))
                mujoco.mjd_quatIntegrate(found.qvel[i, turns], dt, of_q, of_way, unasked)
                places[:, i, turns, turns] = of_q.reshape(3, 3), of_way.reshape(3, 3)
    return places
