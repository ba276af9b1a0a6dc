"""The checks that a scene's gradient gets on any engine, in the order of what spoils most, and the verdict."""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from tog_mjx.checks.file.preflight import Remark
from tog_mjx.checks.measured.agreement import Sweep, agreement, between_jumps, sweep
from tog_mjx.checks.measured.estimators import which_to_follow
from tog_mjx.checks.measured.jumps import Jumps, find_jumps, judge_jumps, lacks
from tog_mjx.checks.measured.motion import Motion, Recorder
from tog_mjx.checks.measured.stages import contacts, finite, growth, untouched
from tog_mjx.checks.measured.touch_down import touch_down
from tog_mjx.checks.measured.variants import solver, stiffness, time_step
from tog_mjx.checks.measured.zeros import cancelled, zeros
from tog_mjx.checks.told.finding import Finding, Level, Report, Verdict, reported

Check = tuple[str, Callable[[], Finding]]


class InOrder:
    """The checks of a motion, whose directions have `names`."""

    def __init__(self, simulation: Recorder, motion: Motion, names: tuple[str, ...]):
        self.simulation, self.motion, self.names = simulation, motion, names
        self._at = np.zeros(len(simulation.directions))

    @property
    def is_finite(self) -> bool:
        """Whether the gradient is. Else nothing but `finite` means anything."""
        return bool(np.isfinite(self.motion.slopes).all())

    @functools.cached_property
    def nothing(self) -> Finding | None:
        """Of a parameter what is told where all that follows from it undoes what it does."""
        parameter = self.simulation.scene.x.parameter
        if parameter is None or len(parameter.arrays) < 2:
            return None
        return cancelled(self.motion.slopes, self._differences, self.motion.value, self.names)

    @functools.cached_property
    def _differences(self) -> Sweep:
        return sweep(self.simulation.values, self._at, self.simulation.directions)

    @functools.cached_property
    def _jumps(self) -> Jumps | None:
        return find_jumps(self.simulation.values, self._at, self.simulation.directions, self._differences)

    def of_any_engine(self) -> Iterator[Check]:
        yield "finite", lambda: finite(self.motion)
        if not self.is_finite:
            return
        yield from self.of_motion({"solver": solver})
        if nothing := self.nothing:
            yield "zeros", lambda: nothing
            yield from self.of_motion({"growth": growth, "contacts": contacts})
            return
        yield "zeros", self._zeros
        yield from self.of_motion({"growth": growth})  # Before what it is the cause of.
        yield "agreement", self._agreement
        if lacks(self.motion.slopes, self._jumps):
            yield "time step", lambda: Finding("time step", Level.FINE, "not halved: no time step mends 'agreement'")
        else:
            yield from self.of_motion({"time step": time_step})
        yield from self.of_motion({"contacts": contacts, "stiffness": stiffness})

    def of_motion(self, checks: dict[str, Callable]) -> Iterator[Check]:
        return ((name, functools.partial(check, self.simulation, self.motion)) for name, check in checks.items())

    def estimators(self) -> Finding:
        scene, jumps = self.simulation.scene, self._jumps if self.is_finite else None
        functions = self.simulation.values, self.simulation.value
        return which_to_follow(*functions, self._at, scene.x.scale, self.motion.slopes, jumps, scene.y.names)

    def _zeros(self) -> Finding:
        scene, motion = self.simulation.scene, self.motion
        kin, unused = (scene.x.kin, scene.x.unused) if self.names == scene.x.names else (None, None)  # Directions: all.
        unreached = lambda: untouched(self.simulation, motion)  # noqa: E731
        outputs = scene.y.names, scene.y.bodies
        return zeros(motion.slopes, self._differences, self.names, *outputs, unreached, kin, unused)

    def _agreement(self) -> Finding:
        simulation, slopes, jumps = self.simulation, self.motion.slopes, self._jumps
        where = lambda some: touch_down(simulation, *some.sides)  # noqa: E731
        lengths = np.linalg.norm(simulation.directions, axis=0)
        plain = agreement(slopes, self._differences, simulation.remedy)
        judged = judge_jumps(plain, slopes, jumps, self.names, simulation.scene.y.names, where, lengths)
        has_jumps = simulation.scene.differentiation == "saltation"
        if judged.level < Level.FAULT or not has_jumps or (jumps and jumps.are_many):
            return judged
        return between_jumps(judged, slopes, simulation.differentiated("implicit").slopes, self._differences)


def tell(findings: Iterable[Finding], say: Report) -> None:
    for finding in findings:
        say(finding.check, finding)


def verdict(
    subject: str,
    checks: InOrder,
    others: Iterable[Check],
    findings: list[Finding],
    remarks: Sequence[Remark],
    say: Report,
) -> Verdict:
    """Of all checks, those that every engine has and then the `others`.

    Args:
      findings: those so far, of the `remarks` among them; more are added as they come.
    """
    for name, check in itertools.chain(checks.of_any_engine(), others):
        findings.append(reported(name, check, say))
    for remark in remarks:
        if (measured := remark.finding(findings)) != (feared := remark.finding()):
            findings[findings.index(feared)] = measured
            say("preflight", measured)
    scene, motion = checks.simulation.scene, checks.motion
    lengths = np.linalg.norm(checks.simulation.directions, axis=0)
    gradient = (motion.slopes / lengths).tolist()
    outputs = scene.y.names, motion.value.tolist()
    told = tuple(findings), checks.names, *outputs, gradient, lengths.tolist()
    return Verdict(subject, *told, engine=checks.simulation.engine)
