"""A verdict as one page, which needs nothing else and no network."""

import base64
import io
from importlib import resources
from pathlib import Path

import jinja2
from matplotlib import rc_context

from tog_mjx.checks.told.finding import Finding, Level, Verdict
from tog_mjx.drawing.figures.curves import draw_finding, has_figure
from tog_mjx.drawing.figures.style import RC
from tog_mjx.running.storage import atomic_write

_WORDS = {Level.FINE: "fine", Level.CARE: "care", Level.FAULT: "fault"}


def write_page(path: Path, title: str, verdict: Verdict) -> None:
    """Writes the page, atomically."""
    root = resources.files(__package__)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    template = environment.from_string(root.joinpath("verdict_page.html").read_text())
    page = template.render(
        title=title,
        verdict=verdict,
        findings=[(finding, _WORDS[finding.level], _picture(finding)) for finding in verdict.findings],
        style=root.joinpath("page.css").read_text(),
    )
    with atomic_write(path) as file:
        file.write(page.encode())


def _picture(finding: Finding) -> str:
    """The finding's curves as a data URI, or nothing."""
    if not has_figure(finding):
        return ""
    image = io.BytesIO()
    with rc_context(RC):
        draw_finding(finding).savefig(image, format="png", dpi=120)
    return "data:image/png;base64," + base64.b64encode(image.getvalue()).decode()
