"""A verdict as one page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from tog_mjx.drawing.figures.curves import figures
from tog_mjx.drawing.report.page import Picture, Section, Table, write_page

_DERIVATIVES = (
    "Value, and derivative by each variable (along a random direction, per unit of its length); last, how large a "
    "displacement of each was taken for a large one."
)


def write_verdict(path: Path, title: str, line: str, verdict: Mapping[str, Any]) -> None:
    """Writes the page, atomically.

    Args:
      line: the verdict in one line.
      verdict: as `tog_mjx/checks/told/verdict.schema.json` describes it.
    """
    findings = verdict["findings"]
    checks = Table(
        ["check", "finding", "what it says"],
        [[found["check"], found["level"], _told(found)] for found in findings],
        "All checks, what each found, and what to do.",
        [found["level"] for found in findings],
    )
    pictures = [
        Picture(drawn.figure, drawn.name, drawn.caption)
        for found in findings
        for drawn in figures(found["check"], found["level"], found["curves"])
    ]
    rows = [
        [name, _number(value, 6), *(_number(slope) for slope in slopes)]
        for name, value, slopes in zip(verdict["outputs"], verdict["value"], verdict["gradient"], strict=True)
    ]
    rows.append(["scale", "", *(_number(size) for size in verdict["scale"])])
    gradient = Table(["output", "value", *verdict["variables"]], rows, _DERIVATIVES)
    sections = [
        Section("Checks", table=checks),
        *([Section("Curves", pictures)] if pictures else []),
        Section("The gradient", table=gradient),
    ]
    subject, heading = f"{title}: {verdict['subject']}", "Can this gradient be trusted?"
    write_page(path, f"{title}: {verdict['verdict']}", subject, [line], sections, heading=heading)


def _told(finding: Mapping[str, Any]) -> str:
    """Its sentence, and the remedy in a line of its own."""
    remedy = Markup("<br><strong>Remedy:</strong> {}").format(finding["remedy"]) if finding["remedy"] else ""
    return Markup("{}").format(finding["sentence"]) + remedy


def _number(value: float | None, digits: int = 4) -> str:
    return "not finite" if value is None else f"{value:.{digits}g}"
