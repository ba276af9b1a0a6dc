"""The checks of a scene's gradient through C MuJoCo: nothing is compiled, and the scene may be one that MJX refuses."""

import dataclasses
import time
from collections.abc import Iterator, Sequence

from tog_mjx.checks.file.preflight import preflight
from tog_mjx.checks.function_verdict import directions_at
from tog_mjx.checks.in_order import Check, InOrder, tell, verdict
from tog_mjx.checks.measured.linearised import Linearised, check_c
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict
from tog_mjx.mjcf.followers import Origin
from tog_mjx.problems.scene_function import SceneFunction
from tog_mjx.running.errors import InputError

ANSWER = "C MuJoCo"
"""The name of the finding that says what it makes of the scene."""


def check_on_c(
    scene: SceneFunction,
    subject: str,
    path: Origin | None,
    say: Report,
    first: Sequence[Finding] = (),
    estimators: bool = False,
) -> Verdict:
    """The verdict on the gradient that engine="mujoco" gives of a scene function.

    Args:
      first: what is found already.

    Raises:
      InputError: for what that engine does not move, see or differentiate.
    """
    directions, names = directions_at(scene.x.scale, scene.x.names)
    simulation = Linearised(scene, directions)
    say("preflight", None)
    remarks = preflight(scene.model, path, scene.start, scene.x, scene.differentiation, "mujoco")
    findings = [remark.finding() for remark in remarks]
    tell(findings, say)
    findings = [*first, *findings]
    say("motion", None)
    checks = InOrder(simulation, simulation.run(), names)

    def others() -> Iterator[Check]:
        if estimators and not (checks.is_finite and checks.nothing):
            yield "estimators", checks.estimators

    return verdict(f"{subject}, through C MuJoCo", checks, others(), findings, remarks, say)


def answer_of_c(scene: SceneFunction, subject: str, path: Origin | None) -> Finding:
    """What is said of C MuJoCo's own gradient where that of another engine is asked for: it weighs nothing there."""
    began = time.perf_counter()
    try:
        found = check_on_c(scene, subject, path, lambda *_: None)
    except InputError as error:
        return Finding(ANSWER, Level.FINE, f"no first answer: {error}")
    seconds = time.perf_counter() - began
    told = f"a first answer in {seconds:.1f} s, on the gradient of its own motion: {found.line}"
    return Finding(ANSWER, Level.FINE, told, seconds)


def instead(
    scene: SceneFunction, subject: str, path: Origin | None, say: Report, why: Sequence[Finding], estimators: bool
) -> Verdict:
    """Where another engine cannot move the scene, as it says `why`: the verdict on C MuJoCo's gradient, for which that
    weighs nothing. Where C MuJoCo cannot either, that weighs."""
    try:
        check_c(scene)
    except InputError as error:
        findings = [*why, Finding(ANSWER, Level.FINE, f"nor can it be judged through C MuJoCo: {error}")]
        tell(findings, say)
        return Verdict(subject, tuple(findings))
    harmless = [dataclasses.replace(some, level=Level.FINE) for some in why]
    tell(harmless, say)
    return check_on_c(scene, subject, path, say, harmless, estimators)
