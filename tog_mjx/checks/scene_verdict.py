"""The checks of a scene."""

import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import mujoco
import numpy as np

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.function_verdict import directions_at
from tog_mjx.checks.measured.agreement import agreement, between_jumps, sweep
from tog_mjx.checks.measured.cost import cost
from tog_mjx.checks.measured.estimators import which_to_follow
from tog_mjx.checks.measured.jumps import Jumps, find_jumps, judge_jumps, lacks
from tog_mjx.checks.measured.modes import differentiation, reverse
from tog_mjx.checks.measured.parity import parity
from tog_mjx.checks.measured.recorded import Motion, Simulation
from tog_mjx.checks.measured.stages import contacts, finite, growth, untouched
from tog_mjx.checks.measured.touch_down import touch_down
from tog_mjx.checks.measured.variants import precision, solver, stiffness, time_step
from tog_mjx.checks.measured.zeros import cancelled, zeros
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.checks.told.failure import failure
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict, reported
from tog_mjx.mjcf.followers import Origin, compiled
from tog_mjx.mjcf.scene import require_time_step
from tog_mjx.problems.outputs import Cost
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.problems.wrt import default_wrt
from tog_mjx.running.errors import InputError, require_kind
from tog_mjx.running.quiet import without_warnings
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.mjx_state import default_start, require_state


def check_scene(
    model: mujoco.MjModel | mujoco.MjSpec,
    start: mujoco.MjData | None = None,
    *,
    steps: int = 100,
    wrt: str | None = None,
    output: str | Cost = "qpos",
    differentiation: str = "implicit",
    path: str | Path | None = None,
    quick: bool = False,
    estimators: bool = False,
    report: Report | None = None,
) -> Verdict:
    """Can the gradient of this scene's motion be trusted?

    Args:
      model: any, or its MjSpec. Of one that MJX cannot simulate the verdict says why not.
      start: the state, and the controls held; `tog_mjx.stepping.mjx_state.default_start` if None. It is left as it is.
      steps, differentiation: see `SceneFunction`.
      output: see `tog_mjx.problems.outputs.Outputs`.
      wrt: see `tog_mjx.problems.wrt.Displacements`; if None the controls, or the velocities of a scene without
        actuators.
      path: the MJCF file that the model was read from: the preflight then names its lines, and variables move all that
        follows from them, see `tog.Parameter`.
      quick: leaves out what compiles the motion again: float32, stock MJX, the cost, and of a fault reverse mode.
      estimators: ask too whether to follow this gradient or a stochastic one, see `checks.measured.estimators`;
        of several outputs, to lower the one whose derivative is largest.

    Raises:
      InputError: for arguments of a wrong kind, a start of another model, what is not in the scene, or a cost that
        fails or returns no number.
    """
    kinds = (mujoco.MjModel, mujoco.MjSpec)
    remedy = "what mjx.put_model made it of" if isinstance(model, mjx.Model) else "of a Scene its .model"
    require_kind("the model", model, kinds, f"give the mujoco.MjModel ({remedy})")
    origin: Origin | None = path
    if isinstance(model, mujoco.MjSpec):
        model, origin = compiled(model)
    require_time_step(model, "the model")
    if path is not None:
        require_kind("path", path, (str, Path), "give that of the MJCF file")
    if start is None:
        start = default_start(model)
    require_kind("the start", start, (mujoco.MjData, mjx.Data), "give a mujoco.MjData of the model")
    require_state(model, start)
    by = default_wrt(model) if wrt is None else wrt
    why = "" if wrt or model.nu else ", as the scene has no actuators"
    say: Report = report or (lambda *_: None)
    with jax.enable_x64(), without_warnings():
        scene = SceneFunction(model, start, steps, by, output, differentiation, origin)
        told = ", ".join(scene.y.names[:3]) + ", ..." * (len(scene.y.names) > 3)
        subject = f"{told} after {steps} steps, by {by}{why}"
        say("preflight", None)
        remarks = preflight(model, path, start, scene.x, differentiation)
        findings = [remark.finding() for remark in remarks]
        for finding in findings:
            say("preflight", finding)
        if any(some.blocks for some in remarks):
            return Verdict(subject, tuple(findings))
        say("motion", None)
        directions, names = directions_at(scene.x.scale, scene.x.names)
        try:
            simulation = Simulation(scene, directions)
            motion = simulation.run()
            for name, check in _checks(simulation, motion, names, findings, quick, estimators):
                findings.append(reported(name, check, say))
        except InputError:
            raise
        except Exception as error:
            # What is not MJX's failure is ours, and is raised.
            failed = failure(model, error)
            if failed is None:
                raise
            findings.append(failed)
            say("motion", failed)
            return Verdict(subject, tuple(findings))
        for i, remark in enumerate(remarks):
            if (measured := remark.finding(findings)) != findings[i]:
                findings[i] = measured
                say("preflight", measured)
    lengths = np.linalg.norm(directions, axis=0)
    gradient = (motion.slopes / lengths).tolist()
    return Verdict(subject, tuple(findings), names, scene.y.names, motion.value.tolist(), gradient, lengths.tolist())


def _checks(
    simulation: Simulation,
    motion: Motion,
    names: tuple[str, ...],
    found: Sequence[Finding],
    quick: bool,
    estimators: bool,
) -> Iterator[tuple[str, Callable[[], Finding]]]:
    """What to run, in the order of what spoils most, given what is `found` so far.

    Nothing else means anything where the gradient is not finite.
    """
    scene, at = simulation.scene, np.zeros(len(simulation.directions))

    def compare(jumps: Jumps | None) -> Finding:
        names = scene.y.names
        return which_to_follow(simulation.values, simulation.value, at, scene.x.scale, motion.slopes, jumps, names)

    def of_motion(checks: dict[str, Callable]) -> Iterator[tuple[str, Callable[[], Finding]]]:
        return ((name, functools.partial(check, simulation, motion)) for name, check in checks.items())

    yield "finite", lambda: finite(motion)
    has_rival = scene.differentiation != "saltation"  # Stock MJX has no gradient with jumps.
    if not np.isfinite(motion.slopes).all():
        if has_rival and not quick:
            yield from of_motion({"differentiation": differentiation})
        if estimators:
            yield "estimators", lambda: compare(None)
        return
    yield from of_motion({"solver": solver})
    differences = sweep(simulation.values, at, simulation.directions)
    follows = scene.x.parameter is not None and len(scene.x.parameter.arrays) > 1
    if follows and (nothing := cancelled(motion.slopes, differences, motion.value, names)):
        yield "zeros", lambda: nothing
        yield from of_motion({"growth": growth, "contacts": contacts, "parity": parity})
        return
    unreached = lambda: untouched(simulation, motion)  # noqa: E731
    kin, unused = (scene.x.kin, scene.x.unused) if names == scene.x.names else (None, None)  # Directions are of all.
    outputs = scene.y.names, scene.y.bodies
    yield "zeros", lambda: zeros(motion.slopes, differences, names, *outputs, unreached, kin, unused)
    yield from of_motion({"growth": growth})  # Before what it is the cause of.
    jumps = find_jumps(simulation.values, at, simulation.directions, differences)
    where = lambda some: touch_down(simulation, *some.sides)  # noqa: E731
    lengths = np.linalg.norm(simulation.directions, axis=0)

    def agree() -> Finding:
        plain = agreement(motion.slopes, differences)
        judged = judge_jumps(plain, motion.slopes, jumps, names, scene.y.names, where, lengths)
        if judged.level < Level.FAULT or scene.differentiation != "saltation" or (jumps and jumps.are_many):
            return judged
        return between_jumps(judged, motion.slopes, simulation.differentiated("implicit").slopes, differences)

    yield "agreement", agree
    if lacks(motion.slopes, jumps):
        yield "time step", lambda: Finding("time step", Level.FINE, "not halved: no time step mends 'agreement'")
    else:
        yield from of_motion({"time step": time_step})
    yield from of_motion({"contacts": contacts, "stiffness": stiffness, "parity": parity})
    if not quick:
        yield from of_motion({"precision": precision})
    if not quick or all(some.level < Level.FAULT for some in found):  # It changes no verdict of a fault.
        args = simulation.value, at, simulation.directions, motion.slopes
        yield "reverse mode", lambda: reverse(*args, compile_quickly)
    if not quick:
        if has_rival:
            yield from of_motion({"differentiation": differentiation})
        yield "cost", lambda: cost(simulation)
    if estimators:
        yield "estimators", lambda: compare(jumps)
