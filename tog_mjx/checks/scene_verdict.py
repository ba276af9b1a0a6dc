"""The checks of a scene."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import mujoco
import numpy as np

from tog_mjx.checks.c_verdict import ANSWER, answer_of_c, check_on_c, instead
from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.function_verdict import directions_at
from tog_mjx.checks.in_order import Check, InOrder, tell, verdict
from tog_mjx.checks.measured.cost import cost
from tog_mjx.checks.measured.modes import differentiation as both_ways
from tog_mjx.checks.measured.modes import reverse
from tog_mjx.checks.measured.parity import parity
from tog_mjx.checks.measured.recorded import Simulation
from tog_mjx.checks.measured.variants import precision
from tog_mjx.checks.step_check import compile_quickly
from tog_mjx.checks.told.failure import failure
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict, reported
from tog_mjx.mjcf.followers import Origin, compiled
from tog_mjx.mjcf.scene import require_time_step
from tog_mjx.problems.outputs import Cost
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.problems.wrt import default_wrt
from tog_mjx.running.errors import InputError, require_choice, require_kind
from tog_mjx.running.quiet import without_warnings
from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.mjx_state import default_start, require_state

ENGINES = ("mjx", "mujoco")
"""Of any scene."""


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
    engine: str = "mjx",
) -> Verdict:
    """Can the gradient of this scene's motion be trusted?

    Args:
      model: any, or its MjSpec. Of one that MJX cannot simulate the verdict says why not, and judges the gradient
        through C MuJoCo instead.
      start: the state, and the controls held; if None the keyframe `start`, else the first one, else the initial pose.
        It is left as it is.
      steps: time steps of the motion.
      wrt: "ctrl", "qpos", "qvel", "act", "mocap_pos", "mocap_quat" or a field of floats of `mjx.Model`, or one number
        of it, as in "geom_friction[2, 0]"; see `tog_mjx.problems.wrt.Displacements`. If None the controls, or the
        velocities of a scene without actuators.
      output: of the last state: "qpos", "qvel", "acc", the name of a site or of a sensor, or one number of it; or a
        function of the last `mjx.Data` that returns a number; see `tog_mjx.problems.outputs.Outputs`.
      differentiation: see `tog.step`.
      path: the MJCF file that the model was read from: the preflight then names its lines, and variables move all that
        follows from them, see `tog.Parameter`.
      quick: leaves out what compiles the motion again: float32, stock MJX, the cost, and of a fault reverse mode.
      estimators: ask too whether to follow this gradient or a stochastic one, see `checks.measured.estimators`;
        of several outputs, to lower the one whose derivative is largest.
      engine: "mjx", or "mujoco": the gradient through C MuJoCo, for which nothing compiles.

    Raises:
      InputError: for arguments of a wrong kind, a start of another model, what is not in the scene, or a cost that
        fails or returns no number.

    Units: the model's; the gradient is per unit of each variable.
    Gradient: none of the verdict. It is about that of the motion, which `tog.step` tells.
    Source: own, `scripts/findings`; which gradient to follow: Suh et al., ICML 2022.
    """
    kinds = (mujoco.MjModel, mujoco.MjSpec)
    remedy = "what mjx.put_model made it of" if isinstance(model, mjx.Model) else "of a Scene its .model"
    require_kind("the model", model, kinds, f"give the mujoco.MjModel ({remedy})")
    origin: Origin | None = path
    if isinstance(model, mujoco.MjSpec):
        model, origin = compiled(model)
    require_choice("engine", engine, ENGINES)
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
        if engine == "mujoco":
            return check_on_c(scene, subject, path, say, estimators=estimators)
        return _check_on_mjx(scene, subject, path, quick, estimators, say)


def _check_on_mjx(
    scene: SceneFunction, subject: str, path: str | Path | None, quick: bool, estimators: bool, say: Report
) -> Verdict:
    # Of what is native to MJX, C MuJoCo has the like.
    like = "implicit" if scene.differentiation == "native" else scene.differentiation
    on_c = dataclasses.replace(scene, differentiation=like), subject, path
    say("preflight", None)
    remarks = preflight(scene.model, path, scene.start, scene.x, scene.differentiation)
    feared = [remark.finding() for remark in remarks]
    if any(some.blocks for some in remarks):
        return instead(*on_c, say, feared, estimators)
    findings = [reported(ANSWER, lambda: answer_of_c(*on_c), say), *feared]
    tell(feared, say)
    say("motion", None)
    directions, names = directions_at(scene.x.scale, scene.x.names)
    try:
        simulation = Simulation(scene, directions)
        checks = InOrder(simulation, simulation.run(), names)
        others = _of_mjx(simulation, checks, findings, quick, estimators)
        return verdict(subject, checks, others, findings, remarks, say)
    except InputError:
        raise
    except Exception as error:
        # What is not MJX's failure is ours, and is raised.
        failed = failure(scene.model, error)
        if failed is None:
            raise
        return instead(*on_c, say, [failed], estimators)


def _of_mjx(
    simulation: Simulation, checks: InOrder, found: Sequence[Finding], quick: bool, estimators: bool
) -> Iterator[Check]:
    """What only MJX's gradient is asked, given what is `found` so far."""
    has_rival = not quick and simulation.scene.differentiation != "saltation"  # Stock MJX has no gradient with jumps.
    if not checks.is_finite:
        if has_rival:
            yield from checks.of_motion({"differentiation": both_ways})
    elif checks.nothing:
        yield from checks.of_motion({"parity": parity})
        return
    else:
        yield from checks.of_motion({"parity": parity})
        if not quick:
            yield from checks.of_motion({"precision": precision})
        if not quick or all(some.level < Level.FAULT for some in found):  # It changes no verdict of a fault.
            args = simulation.value, np.zeros(len(simulation.directions)), simulation.directions, checks.motion.slopes
            yield "reverse mode", lambda: reverse(*args, compile_quickly)
        if has_rival:
            yield from checks.of_motion({"differentiation": both_ways})
        if not quick:
            yield "cost", lambda: cost(simulation)
    if estimators:
        yield "estimators", checks.estimators
