"""Checks that run the same motion otherwise: finer in time, softer, harder, with more solver iterations, in float32."""

import itertools

import jax
import numpy as np
from jaxtyping import Float

from tog_mjx._mjx import mjx
from tog_mjx.checks.agreement import relative
from tog_mjx.checks.finding import Finding, Level
from tog_mjx.checks.motion import Motion, Simulation
from tog_mjx.checks.single import judge_single

CONVERGED = 1e-6
"""Newton correction, relative to the accelerations, below which a solver counts as converged."""
SLIGHT, GRAVE = 1e-3, 0.05
"""Relative errors of an unconverged solver that are told, and that make it a fault."""


def time_step(simulation: Simulation, motion: Motion) -> Finding:
    """Does the gradient converge as the time step is halved, at the same horizon?"""
    found = [motion.slopes]
    for halvings in (1, 2):
        dt = simulation.model.opt.timestep / 2**halvings
        finer = simulation.model.tree_replace({"opt.timestep": dt})
        found.append(simulation.run(finer, simulation.scene.steps * 2**halvings).slopes)
    changes = [relative(a, b) for a, b in itertools.pairwise(found)]
    sizes = [float(np.linalg.norm(some)) for some in found]
    curves = {"time step, relative": [1.0, 0.5, 0.25], "gradient norm": sizes}
    steps = f"{changes[0]:.1%} from dt to dt/2, {changes[1]:.1%} to dt/4"
    if not np.isfinite(changes).all():
        return Finding("time step", Level.CARE, "with a finer time step the gradient is not finite", None, "", curves)
    if changes[0] <= 0.1:
        return Finding("time step", Level.FINE, f"the gradient changes by {steps}", changes[0], "", curves)
    remedy = "reduce the time step, or soften the contact, until halving it no longer matters"
    sentence = f"the gradient is that of the time step, not of the physics: it changes by {steps}"
    return Finding("time step", Level.FAULT if changes[0] > 0.5 else Level.CARE, sentence, changes[0], remedy, curves)


def stiffness(simulation: Simulation, motion: Motion) -> Finding:
    """How far does the gradient depend on the contact's stiffness, a number that is rarely measured?"""
    if not (motion.distance < 0).any():
        return Finding("stiffness", Level.FINE, "nothing touches, so the contact's stiffness has no part in it")
    factors = (0.25, 4.0)
    found = {factor: simulation.run(_stiffer(simulation.model, factor)).slopes for factor in factors}
    changes = {factor: relative(motion.slopes, some) for factor, some in found.items()}
    cosines = {factor: _cosine(motion.slopes, some) for factor, some in found.items()}
    curves = {
        "stiffness, relative": [factors[0], 1.0, factors[1]],
        "gradient norm": [float(np.linalg.norm(some)) for some in (found[0.25], motion.slopes, found[4.0])],
    }
    worst = max(changes.values())
    sentence = (
        f"contact four times softer or harder changes the gradient by {changes[0.25]:.0%} and {changes[4.0]:.0%} "
        f"(cosines {cosines[0.25]:.2f} and {cosines[4.0]:.2f})"
    )
    if min(cosines.values()) >= 0.5:
        return Finding("stiffness", Level.FINE, sentence, worst, "", curves)
    remedy = "the direction depends on solref: identify it, or average over a range of it"
    return Finding("stiffness", Level.CARE, sentence, worst, remedy, curves)


def _stiffer(model: mjx.Model, factor: float) -> mjx.Model:
    """With contacts of so many times the stiffness and the same damping ratio; the friction of `solreffriction` too."""
    names = [name for name in ("geom_solref", "pair_solref") if getattr(model, name).size]
    return model.tree_replace({name: _scaled(getattr(model, name), factor) for name in names})


def _scaled(solref: Float[jax.Array, "N 2"], factor: float) -> Float[jax.Array, "N 2"]:
    """(time constant, damping ratio), or with negative numbers (-stiffness, -damping)."""
    root = factor**0.5
    is_direct = solref[:, :1] <= 0
    direct, standard = np.array([factor, root]), np.array([1 / root, 1.0])
    return jax.numpy.where(is_direct, solref * direct, solref * standard)


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float((a * b).sum() / size) if size else 1.0


def solver(simulation: Simulation, motion: Motion, most: int = 4) -> Finding:
    """Has the constraint solver converged at every step? If not: double its iterations until the gradient settles."""
    correction, opt = float(motion.correction), simulation.model.opt
    if correction <= CONVERGED:
        sentence = f"the solver's answers are within {correction:.0e} of the exact ones at every step"
        return Finding("solver", Level.FINE, sentence, correction)
    found, numbers = [motion], [opt.iterations]
    while len(numbers) <= most and float(found[-1].correction) > CONVERGED and not _settled(found):
        numbers.append(2 * numbers[-1])
        options = {"opt.iterations": numbers[-1], "opt.ls_iterations": max(opt.ls_iterations, 50)}
        found.append(simulation.run(simulation.model.tree_replace({**options, "opt.tolerance": opt.tolerance * 1e-3})))
    change, moved = relative(motion.slopes, found[-1].slopes), relative(motion.value, found[-1].value)
    curves = {
        "iterations": [float(n) for n in numbers],
        "gradient norm": [float(np.linalg.norm(some.slopes)) for some in found],
        "correction": [float(some.correction) for some in found],
    }
    sentence = (
        f"with {numbers[0]} iterations the solver's answers are off by up to {correction:.0e}; "
        f"{numbers[-1]} iterations change the gradient by {change:.1%} and the value by {moved:.0e}"
    )
    # The implicit gradient may stay the same while the value does not: then it is the gradient of another value.
    if max(change, correction) <= SLIGHT:
        return Finding("solver", Level.FINE, sentence, change, "", curves)
    enough = f"iterations='{numbers[-1]}' ls_iterations='{max(opt.ls_iterations, 50)}'"
    remedy = f"set <option solver='Newton' {enough}>"
    level = Level.FAULT if max(change, correction) > GRAVE else Level.CARE
    return Finding("solver", level, f"this is the gradient of an unconverged solve: {sentence}", change, remedy, curves)


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
