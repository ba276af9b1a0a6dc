"""Checks that run the same motion otherwise: finer in time, softer, harder, with more solver iterations, in float32."""

from collections.abc import Sequence

import jax
import mujoco
import numpy as np
from jaxtyping import Float

from tog_mjx.checks.measured.agreement import relative
from tog_mjx.checks.measured.motion import Motion, Recorder
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.checks.measured.single import judge_single
from tog_mjx.checks.told.finding import Finding, Level

STEADY = 0.1
"""Change of the gradient by half the time step that is believed: a step along it is off by 6 degrees or 10 % of its
length, which no descent feels."""
LOST = 0.5
"""A gradient farther from its limit than this, of its own size, has more to do with the time step than with the
physics: what is gained by it on this motion may be lost on any other of the same scene."""
HALVINGS, LONGEST = 4, 20_000
"""Halvings at most, and steps of a motion after the second one: all together take 30 times as long as the first motion,
and a verdict is to take minutes. Two halvings judge; more only look for the time step that settles."""
DIRECTION = 0.5
"""Cosine of gradients. Within 60 degrees a step along one is downhill for the other, with half of the gain or more."""
TENFOLD = 0.9
"""Relative change. A gradient that is proportional to the stiffness, or to its inverse, changes by 0.75 as that changes
fourfold, and a line search mends it. Ten times and more, or nothing left, are told: some contact is made or lost."""
CONVERGED = 1e-6
"""Newton correction, relative to the accelerations: solvers at work leave 1e-8 to 1e-16, and the derivative of the
exact solution is as wrong as the solution is, so that six digits of it hold."""
SLIGHT = 1e-3
"""Relative errors of an unconverged solver up to here are no more than differences can see (`agreement.SETTLED`)."""
GRAVE = 0.05
"""Above it they are a fault, sooner than those of a time step: they say nothing of the scene, differ from point to
point, and more iterations cost little."""


def time_step(simulation: Recorder, motion: Motion) -> Finding:
    """Does the gradient converge as the time step is halved, at the same horizon? If not: until it settles.

    A motion of one step is not: it is that map which is asked for, and not its limit, in which an activation reaches
    the positions that it does not reach within one step.
    """
    if simulation.scene.steps == 1:
        return Finding("time step", Level.FINE, "not halved: the motion is one time step, with nothing to refine")
    found: list[np.ndarray] = [motion.slopes]
    changes: list[float] = []
    most = max(2, min(HALVINGS, int(np.log2(LONGEST / simulation.scene.steps))))
    while len(changes) < 2 or (len(changes) < most and np.max(changes[-2:]) > STEADY):
        factor = 2 ** len(found)
        finer = simulation.changed({"opt.timestep": simulation.scene.model.opt.timestep / factor})
        found.append(simulation.run(finer, simulation.scene.steps * factor).slopes)
        changes.append(relative(found[-2], found[-1]))
    sizes = [float(np.linalg.norm(some)) for some in found]
    curves = {"time step, relative": [0.5**i for i in range(len(found))], "gradient norm": sizes}
    return judge_time_step(changes, float(simulation.scene.model.opt.timestep), simulation.scene.steps, curves)


def judge_time_step(changes: Sequence[float], dt: float, steps: int, curves: dict | None = None) -> Finding:
    """Of the changes of the gradient from each time step to half of it: two from dt on, and more until two are small,
    as one may be by chance.

    The gradient is at fault where the first do not contract, where they come to more than half of it, added up to the
    limit as a geometric series, or where none of the time steps settles it.
    """
    first, second = changes[:2]
    told = ", ".join(f"{change:.1%} {'from dt ' * (not i)}to dt/{2 ** (i + 1)}" for i, change in enumerate(changes))

    def say(level: Level, sentence: str, remedy: str = "") -> Finding:
        return Finding("time step", level, sentence, first, remedy, curves or {})

    if not np.isfinite(changes).all():
        number = int(np.isfinite(changes).argmin()) + 1
        sentence = f"with the time step dt/{2**number} the gradient is not finite, so that it has no limit"
        return say(Level.FAULT, sentence, "check the scene with that time step: 'finite' names the first bad step")
    is_settled, may_settle = max(changes[-2:]) <= STEADY, changes[-1] <= STEADY
    if is_settled and len(changes) == 2:
        return say(Level.FINE, f"the gradient changes by {told}")
    if may_settle:
        finer = 2 ** (len(changes) - 1 - is_settled)
        told += f"; it {'settles' if is_settled else 'may settle'} at dt/{finer}, {dt / finer:.4g} s"
        remedy = f"set <option timestep='{dt / finer:.4g}'> and take {steps * finer} steps, or soften the contact"
    else:
        told += ", and does not settle"
        remedy = (
            "reduce the time step further, soften the contact or take fewer steps, until halving it does not matter"
        )
    limit = first**2 / (first - second) if second < first else np.inf
    if is_settled and limit <= LOST:
        return say(Level.CARE, f"the gradient depends on the time step: it changes by {told}", remedy)
    sentence = f"the gradient is that of the time step, not of the physics: it changes by {told}"
    return say(Level.FAULT, sentence, remedy)


def stiffness(simulation: Recorder, motion: Motion) -> Finding:
    """How far does the gradient depend on the contact's stiffness, a number that is rarely measured?"""
    if not (motion.distance < 0).any():
        return Finding("stiffness", Level.FINE, "nothing touches, so the contact's stiffness has no part in it")
    changed = [simulation.changed(stiffer(simulation.scene.model, factor)) for factor in (0.25, 4.0)]
    return judge_stiffness(motion.slopes, *(simulation.run(model).slopes for model in changed))


def judge_stiffness(
    slopes: Float[np.ndarray, "m k"], soft: Float[np.ndarray, "m k"], hard: Float[np.ndarray, "m k"]
) -> Finding:
    """Of the gradient, and those with contacts four times softer and harder."""
    changes = [relative(slopes, some) for some in (soft, hard)]
    cosines = [_cosine(slopes, some) for some in (soft, hard)]
    curves = {
        "stiffness, relative": [0.25, 1.0, 4.0],
        "gradient norm": [float(np.linalg.norm(some)) for some in (soft, slopes, hard)],
    }
    worst = float(np.max(changes))
    sentence = (
        f"contact four times softer or harder changes the gradient by {changes[0]:.0%} and {changes[1]:.0%} "
        f"(cosines {cosines[0]:.2f} and {cosines[1]:.2f})"
    )
    if np.min(cosines) >= DIRECTION and worst <= TENFOLD:  # Neither of which NaN passes.
        return Finding("stiffness", Level.FINE, sentence, worst, "", curves)
    remedy = "the gradient hangs on solref: identify it, or average over a range of it"
    return Finding("stiffness", Level.CARE, sentence, worst, remedy, curves)


def stiffer(model: mujoco.MjModel, factor: float) -> dict[str, np.ndarray]:
    """Fields of the model that give contacts so many times the stiffness and the same damping ratio, the friction of
    `solreffriction` too: the same motion, but `factor` ** 0.5 times as fast where all else is too."""
    names = [name for name in ("geom_solref", "pair_solref", "pair_solreffriction") if getattr(model, name).size]
    return {name: _scaled(getattr(model, name), factor) for name in names}


def _scaled(solref: Float[np.ndarray, "N 2"], factor: float) -> Float[np.ndarray, "N 2"]:
    """(time constant, damping ratio), or with negative numbers (-stiffness, -damping); zeros, which mean that friction
    follows the contact's solref, stay."""
    root = factor**0.5
    is_direct = solref[:, :1] <= 0
    direct, standard = np.array([factor, root]), np.array([1 / root, 1.0])
    return np.where(is_direct, solref * direct, solref * standard)


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    """1 where one of them is zero, and has no direction."""
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float((a * b).sum() / size) if size else 1.0


def solver(simulation: Recorder, motion: Motion, most: int = 4) -> Finding:
    """Has the constraint solver converged at every step? If not: double its iterations until the gradient settles."""
    correction, opt = float(motion.correction), simulation.scene.model.opt
    if correction <= CONVERGED:
        sentence = f"the solver's answers are within {correction:.0e} of the exact ones at every step"
        return Finding("solver", Level.FINE, sentence, correction)
    found, numbers, line_search = [motion], [opt.iterations], max(opt.ls_iterations, 50)
    while len(numbers) <= most and float(found[-1].correction) > CONVERGED and not _settled(found):
        numbers.append(2 * numbers[-1])
        options = {"opt.iterations": numbers[-1], "opt.ls_iterations": line_search}
        found.append(simulation.run(simulation.changed({**options, "opt.tolerance": opt.tolerance * 1e-3})))
    curves = {
        "iterations": [float(n) for n in numbers],
        "gradient norm": [float(np.linalg.norm(some.slopes)) for some in found],
        "correction": [float(some.correction) for some in found],
    }
    change, moved = relative(motion.slopes, found[-1].slopes), relative(motion.value, found[-1].value)
    return judge_solver(correction, change, moved, numbers, line_search, curves)


def judge_solver(
    correction: float, change: float, moved: float, numbers: Sequence[int], line_search: int, curves: dict | None = None
) -> Finding:
    """Of the largest Newton correction, and the changes of gradient and value as iterations grow to the last number."""
    sentence = (
        f"with {numbers[0]} iterations the solver's answers are off by up to {correction:.0e}; "
        f"{numbers[-1]} iterations change the gradient by {change:.1%} and the value by {moved:.0e}"
    )
    # The implicit gradient may stay the same while the value does not: then it is the gradient of another value.
    worst = float(np.max([correction, change, moved]))
    if worst <= SLIGHT:
        return Finding("solver", Level.FINE, sentence, change, "", curves or {})
    remedy = f"set <option solver='Newton' iterations='{numbers[-1]}' ls_iterations='{line_search}'>"
    level = Level.CARE if worst <= GRAVE else Level.FAULT  # As NaN is.
    sentence = f"this is the gradient of an unconverged solve: {sentence}"
    return Finding("solver", level, sentence, change, remedy, curves or {})


def _settled(found: list[Motion]) -> bool:
    """Whether the last doubling changed neither value nor gradient."""
    if len(found) < 2:
        return False
    last, before = found[-1], found[-2]
    return max(relative(last.slopes, before.slopes), relative(last.value, before.value)) <= CONVERGED


def precision(simulation: Simulation, motion: Motion) -> Finding:
    """The same in float32, JAX's default; on an accelerator with full matrix products too."""

    def run() -> np.ndarray:
        return Simulation(simulation.scene, simulation.directions, states=False).run().slopes

    with jax.enable_x64(False):
        single, full = run(), None
        if jax.default_backend() != "cpu":  # There they are full anyway.
            with jax.default_matmul_precision("highest"):
                full = run()
    return judge_single(motion.slopes, single, full)
