"""MJX against C MuJoCo on the same states: the motion, one step, and the derivative that `mjd_transitionFD` finds."""

import mujoco
import numpy as np

from tog_mjx.checks.measured.agreement import relative
from tog_mjx.checks.measured.first_apart import first_apart
from tog_mjx.checks.measured.recorded import Motion, Simulation
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.stepping.mjx_state import MOVING, copy_of

STATES, EVERY = 60, 6
"""States along the motion at which a step is compared, and at every so many of them its derivative."""
CLOSE = 1e-4
"""Relative difference of a step that counts as none: solvers leave 1e-8 or less. MJX's own points
for a box on a plane make it 2."""
CLOSE_SLOPES = 1e-2
"""Of its derivative, in the middle of all states, as a difference that straddles a touch is wrong itself."""
FAR = 1e-2
"""Of the whole displacement: a hundredth of the way is less than a model knows. None of the three is a fault: which of
the two engines is right, and whether the motion will ever be run on C MuJoCo, is not known here."""


def parity(simulation: Simulation, motion: Motion) -> Finding:
    """Does a step, and its derivative in the state, equal that of C MuJoCo?"""
    scene = simulation.scene
    chosen = np.unique(np.linspace(0, len(motion.times) - 2, STATES).astype(int))
    apart, slopes_apart, is_steady = [], [], scene.differentiation != "saltation"  # Short differences see no jump.
    for number, i in enumerate(chosen):
        start = motion.at(i)
        one = simulation.run(steps=1, start=start)
        after, jacobian = _step_of_c(
            scene.model, copy_of(scene.model, scene.start, **start), is_steady and number % EVERY == 0
        )
        change, expected = (np.concatenate([end[name] - start[name] for name in MOVING]) for end in (one.at(-1), after))
        apart.append(relative(change, expected))
        slopes_apart.append(relative(one.jacobians[-1], jacobian) if jacobian is not None else np.nan)
    worst, typical = float(np.max(apart)), float(np.median([*(x for x in slopes_apart if np.isfinite(x))] or np.nan))
    drift = _drift(simulation, motion)
    curves = {
        "step": motion.times[chosen].tolist(),
        "difference of a step": [float(x) for x in apart],
        "difference of its derivative": [float(x) for x in slopes_apart],
    }
    sentence = f"at {len(chosen)} states a step of MJX differs from C MuJoCo's by at most {worst:.0e}, " + (
        f"whose mjd_transitionFD does not differentiate {'RK4' if is_steady else 'jumps'}"
        if np.isnan(typical)
        else f"its derivative from mjd_transitionFD by {typical:.0e} (median)"
    )
    sentence += f"; over the whole motion the displacement differs by {drift:.0e}"
    if worst <= CLOSE and drift <= FAR and not typical > CLOSE_SLOPES:
        return Finding("parity", Level.FINE, sentence, worst, "", curves)
    at = chosen[int(np.argmax(apart if worst > CLOSE else np.nan_to_num(slopes_apart)))]
    if found := first_apart(scene.model, copy_of(scene.model, scene.start, **motion.at(at))):
        told = f"{sentence}; in step {motion.times[at]} they part in {found.what}"
        return Finding("parity", Level.CARE, told, worst, found.remedy, curves)
    remedy = (
        "small differences grow over the motion, or lie in its derivative alone: shorten it, or soften its contacts"
    )
    return Finding("parity", Level.CARE, sentence, worst, remedy, curves)


def _step_of_c(
    model: mujoco.MjModel, data: mujoco.MjData, differentiate: bool
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """What moves after a step from `data`, which goes there, and the Jacobian [2 nv + na, 2 nv + na] by central
    differences of 1e-6 if asked for, but for RK4, which MuJoCo refuses."""
    size = 2 * model.nv + model.na
    jacobian = None
    if differentiate and model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        jacobian = np.zeros((size, size))
        mujoco.mjd_transitionFD(model, data, 1e-6, True, jacobian, None, None, None)
    mujoco.mj_step(model, data)
    return {name: getattr(data, name) for name in MOVING}, jacobian


def _drift(simulation: Simulation, motion: Motion) -> float:
    """How far C MuJoCo ends from where MJX ends, relative to how far it went."""
    scene = simulation.scene
    data = copy_of(scene.model, scene.start)
    mujoco.mj_step(scene.model, data, scene.steps)
    first, *_, last = motion.states["qpos"]
    return relative(last - first, data.qpos - first)
