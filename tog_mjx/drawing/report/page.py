"""The page itself: numbers, figures and motions put into the template."""

import base64
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

from tog_mjx.paper.answer import QUESTION, answers
from tog_mjx.paper.comparison import Run, table_rows
from tog_mjx.paper.gallery import Picture
from tog_mjx.running.storage import atomic_write
from tog_mjx.solving.descent import Descent


class Section(NamedTuple):
    """The figures of one simulator, or those of none, under a title."""

    title: str
    pictures: Sequence[Picture]


def write_report(
    path: Path,
    runs: Mapping[Run, Descent],
    sections: Sequence[Section],
    scenarios: Sequence[Mapping[str, Any]],
    table_1: str,
) -> None:
    """Writes the page, atomically: one file that needs nothing else, and no network.

    Args:
      runs: whose numbers stand beside the published ones.
      scenarios: of `tog_mjx.drawing.report.packed`, the interactive part.
      table_1: in Markdown.
    """
    files = resources.files(__package__)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters["data_uri"] = _data_uri
    # Inside a script element, "</" would end it.
    environment.filters["script"] = lambda value: json.dumps(value, allow_nan=False).replace("</", "<\\/")
    template = environment.from_string(files.joinpath("page.html").read_text())
    page = template.render(
        question=QUESTION,
        answers=answers(runs),
        rows=table_rows(runs),
        sections=sections,
        scenarios=scenarios,
        table_1=[[cell.strip() for cell in line.strip("| ").split("|")] for line in table_1.splitlines()],
        style=files.joinpath("page.css").read_text(),
        program=files.joinpath("page.js").read_text(),
    )
    with atomic_write(path) as file:
        file.write(page.encode())


def _data_uri(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
