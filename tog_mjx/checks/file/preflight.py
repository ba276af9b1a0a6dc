"""All that a scene has which MJX does not support, ignores in silence, or of which it is known that it spoils
gradients: told all at once, with names and lines, before anything compiles."""

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from tog_mjx.checks.file import numbers as parameters
from tog_mjx.checks.file import spoilers
from tog_mjx.checks.file.spoilers import Question, Spoiler
from tog_mjx.checks.told.finding import Finding, Level
from tog_mjx.mjcf.lines import Lines
from tog_mjx.mjcf.supported import Culprit, ignored, name_of, unsupported
from tog_mjx.problems.wrt import Displacements
from tog_mjx.running.quiet import without_warnings
from tog_mjx.stepping.mjx_state import copy_of, default_start

_OF_A_KIND = 5
"""Remarks that say the same of other elements; of more only the number is told."""

_REFUSED = {
    unsupported: "MJX does not support it: remove or replace it",
    ignored: "MJX ignores it, so the motion is another one: remove it",
}


class Remark(NamedTuple):
    """What is the matter with a scene and in which element, in which lines (`scene.xml:12`, or ""), and the remedy.

    `blocks`: MJX does not simulate such a scene at all. `measured_by` names the check that measures whether it matters
    to a motion, if there is one.
    """

    level: Level
    what: str
    where: str
    remedy: str
    blocks: bool = False
    measured_by: str = ""

    def __str__(self) -> str:
        where = f" ({self.where})" if self.where else ""
        return f"{self.what}{where}; {self.remedy}"

    def finding(self, measured: Sequence[Finding] = ()) -> Finding:
        """What it says in a verdict: nothing grave where one of the checks has measured that it does no harm."""
        told = ("MJX does not support " if self.blocks else "") + self.what + (f" ({self.where})" if self.where else "")
        # A check that was left out has no value, and has measured nothing.
        is_fine = any(
            some.check == self.measured_by and some.level == Level.FINE and some.value is not None for some in measured
        )
        if self.level == Level.CARE and is_fine:
            told += f"; but '{self.measured_by}' has measured that it does no harm here"
            return Finding("preflight", Level.FINE, told)
        return Finding("preflight", self.level, told, None, self.remedy)


def preflight(
    model: mujoco.MjModel,
    path: str | Path | None = None,
    data: mujoco.MjData | None = None,
    wrt: str | Displacements = "",
    differentiation: str = "implicit",
    engine: str = "mjx",
) -> list[Remark]:
    """Reads a scene, and compiles nothing; the gravest remarks come first.

    Args:
      path: the MJCF file the model was read from, for line numbers.
      data: the state the motion starts from, and its controls; left as it is. If None, where the
        scene starts.
      wrt: the variables of the derivative ("ctrl", "geom_friction[1, 0]", ...): some features spoil those in one field,
        or in one number of it, alone. Or the `Displacements` themselves.
      differentiation: "implicit", "saltation" or "native", see `tog.step`.
      engine: "mjx", or "mujoco": what concerns MJX alone is then left out.

    Raises:
      InputError: for a `wrt` that is not in the scene.
    """
    lines = Lines(model, path)
    remarks = []
    for find, remedy in _REFUSED.items() if engine == "mjx" else ():
        refused = [Spoiler(culprit, remedy, Level.FAULT) for culprit in find(model)]
        remarks += [_remark(lines, spoiler, find is unsupported) for spoiler in _grouped(model, refused)]
    if not any(remark.blocks for remark in remarks):
        with without_warnings():
            x = Displacements(model, wrt, path) if isinstance(wrt, str) and wrt else wrt or None
            array, chosen = (x.array, x.mask) if x else ("", np.zeros(0, bool))
            parameter = x.parameter if x else None
            question = Question(model, _state(model, data), array, chosen, differentiation, parameter)
            remarks += [_remark(lines, spoiler) for spoiler in _grouped(model, _spoilers(question, engine))]
    return sorted(remarks, key=lambda remark: (-remark.blocks, -remark.level))


def _spoilers(question: Question, engine: str) -> Iterator[Spoiler]:
    of_mjx = (*spoilers.OF_MJX, *parameters.OF_MJX) if engine == "mjx" else ()
    for detector in (*of_mjx, *spoilers.DETECTORS, *parameters.DETECTORS):
        yield from detector(question)


def _grouped(model: mujoco.MjModel, spoilers: Iterable[Spoiler]) -> Iterator[Spoiler]:
    """Each kind of them `_OF_A_KIND` times at most: those that say the same but for names and numbers."""
    kinds: dict[tuple, list[Spoiler]] = {}
    for spoiler in spoilers:
        what = spoiler.culprit.what
        for kind, i in spoiler.culprit.elements:
            what = what.replace(name_of(model, kind, i), kind)
        kinds.setdefault((re.sub(r"[-+.e\d]*\d", "#", what), spoiler.level, spoiler.measured_by), []).append(spoiler)
    for same in kinds.values():
        *first, last = same[:_OF_A_KIND]
        more = f" (and {len(same) - _OF_A_KIND} more alike)" if len(same) > _OF_A_KIND else ""
        yield from first
        yield last._replace(culprit=last.culprit._replace(what=last.culprit.what + more))


def _state(model: mujoco.MjModel, data: mujoco.MjData | None) -> mujoco.MjData:
    """A state of its own, with positions, contacts and forces computed."""
    state = default_start(model) if data is None else copy_of(model, data)
    mujoco.mj_forward(model, state)
    return state


def _remark(lines: Lines, spoiler: Spoiler, blocks: bool = False) -> Remark:
    culprit = spoiler.culprit
    return Remark(spoiler.level, culprit.what, _where(lines, culprit), spoiler.remedy, blocks, spoiler.measured_by)


def _where(lines: Lines, culprit: Culprit) -> str:
    """The places of the elements, each once."""
    if culprit.attribute:
        return lines.place_of_option(culprit.attribute)
    places = [lines.place(kind, i) for kind, i in culprit.elements]
    return ", ".join(dict.fromkeys(place for place in places if place))
