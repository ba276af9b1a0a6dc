"""What a check says, and what all of them say together."""

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tog_mjx.running.errors import printable


class Level(enum.IntEnum):
    """How much a finding weighs: nothing, read it before you rely on the gradient, do not rely on it."""

    FINE = 0
    CARE = 1
    FAULT = 2


WORDS = {Level.FINE: "trust", Level.CARE: "trust with care", Level.FAULT: "do not trust"}
"""The verdict, by the gravest finding."""
EXIT_STATUS = {Level.FINE: 0, Level.CARE: 1, Level.FAULT: 3}


@dataclass(frozen=True)
class Finding:
    """A check's plain sentence, the number behind it, and what to do.

    `value` is that number, None where there is none; `remedy` is empty where nothing need be done; `curves` are lists
    of numbers of equal length, for a figure.
    """

    check: str
    level: Level
    sentence: str
    value: int | float | None = None
    remedy: str = ""
    curves: Mapping[str, Sequence[int | float]] = field(default_factory=dict)

    def __str__(self) -> str:
        """How much it weighs, the check, its sentence, and the remedy in a line of its own; of a name in them nothing
        that a terminal would obey."""
        remedy = f"\n      {printable(self.remedy)}" if self.remedy else ""
        return f"{self.level.name.lower():<5} {self.check}: {printable(self.sentence)}{remedy}"

    def as_json(self) -> dict[str, Any]:
        """Of numbers, text, lists and None alone: what is not finite is None."""
        curves = {name: [_number(x) for x in curve] for name, curve in self.curves.items()}
        plain = {"check": self.check, "level": self.level.name.lower(), "sentence": self.sentence}
        return {**plain, "value": _number(self.value), "remedy": self.remedy, "curves": curves}


@dataclass(frozen=True)
class Verdict:
    """All findings about one gradient, in the order of the checks.

    `subject` says what was differentiated; `value` [m] and `gradient` [m, k] are of the outputs named and by the
    variables named, per unit of each (of a random direction: per unit of its length). `scale` [k] is how large a
    displacement was taken for a large one: the variable's own size, or 1. `engine` is what moved a scene or a problem;
    empty of any other function, or if nothing was run.
    """

    subject: str
    findings: tuple[Finding, ...]
    variables: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    value: Sequence[int | float] = ()
    gradient: Sequence[Sequence[int | float]] = ()
    scale: Sequence[int | float] = ()
    engine: str = ""

    @property
    def scaled_gradient(self) -> list[list[int | float]]:
        """`gradient` times `scale` [m, k]: by what the outputs change, to first order, over a large displacement."""
        return [[slope * size for slope, size in zip(row, self.scale, strict=True)] for row in self.gradient]

    def __str__(self) -> str:
        """All findings and the verdict's line, as `tog check` prints them."""
        return "\n".join([*map(str, self.findings), f"{printable(self.subject)}: {self.line}"])

    @property
    def level(self) -> Level:
        """That of the gravest finding."""
        return max((finding.level for finding in self.findings), default=Level.FINE)

    @property
    def word(self) -> str:
        """ "trust", "trust with care" or "do not trust"."""
        return WORDS[self.level]

    @property
    def exit_status(self) -> int:
        """Of a command that asked: 0, 1 or 3."""
        return EXIT_STATUS[self.level]

    @property
    def reason(self) -> Finding | None:
        """The finding that weighs most: of the gravest the first, as checks come in the order of what spoils most;
        what was measured before what is only known of such scenes."""
        gravest = [finding for finding in self.findings if finding.level == self.level > Level.FINE]
        return min(gravest, key=lambda finding: finding.check == "preflight", default=None)

    @property
    def line(self) -> str:
        """The verdict in one line."""
        reason = self.reason
        return self.word + (f": {printable(reason.sentence)}" if reason else ": no check found a fault")

    def as_json(self) -> dict[str, Any]:
        """As `verdict.schema.json`, beside this file, says; what is not finite is None."""
        return {
            "subject": self.subject,
            "engine": self.engine,
            "verdict": self.word,
            "reason": self.reason.check if self.reason else None,
            "variables": list(self.variables),
            "outputs": list(self.outputs),
            "value": [_number(x) for x in self.value],
            "gradient": [[_number(x) for x in row] for row in self.gradient],
            "scale": [_number(x) for x in self.scale],
            "scaled_gradient": [[_number(x) for x in row] for row in self.scaled_gradient],
            "findings": [finding.as_json() for finding in self.findings],
        }


def _number(x: Any) -> float | None:
    return float(x) if x is not None and abs(float(x)) < float("inf") else None


Report = Callable[[str, Finding | None], None]
"""Called with a check's name before it runs, and with its finding after."""


def reported(name: str, check: Callable[[], Finding], report: Report) -> Finding:
    """What a check finds."""
    report(name, None)
    found = check()
    report(name, found)
    return found
