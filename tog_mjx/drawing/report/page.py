"""The page itself: words, tables, figures and motions put into the template."""

import io
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from tog_mjx.drawing.figures.style import RC
from tog_mjx.drawing.report.packed import data_uri
from tog_mjx.running.storage import atomic_write


class Picture(NamedTuple):
    """A figure, or the path of a PNG or a GIF; its name ("Figure 2"), and what it shows in words."""

    image: Path | Figure
    name: str
    caption: str


class Table(NamedTuple):
    """Cells, text or markup; the first one of each row is its heading. `looks` has a class of `page.css` for each."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    looks: Sequence[str] = ()


class Section(NamedTuple):
    """A table, if any, and figures, under a title."""

    title: str
    pictures: Sequence[Picture] = ()
    table: Table | None = None


def write_page(
    path: Path,
    title: str,
    question: str,
    answers: Sequence[str],
    sections: Sequence[Section],
    *,
    heading: str = "",
    scenarios: Sequence[Mapping[str, Any]] = (),
    footer: str = "",
) -> None:
    """Writes the page, atomically: one file that needs nothing else, and no network.

    Args:
      heading: the title, where there is none.
      scenarios: what the interactive part plays, after the answers: see `page.js` for what it uses of each.
      footer: names the program behind the page.
    """
    files = resources.files(__package__)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters["data_uri"] = lambda image: data_uri(_content(image))
    # Inside a script element, "</" would end it.
    environment.filters["script"] = lambda value: json.dumps(value, allow_nan=False).replace("</", "<\\/")
    page = environment.from_string(files.joinpath("page.html").read_text()).render(
        title=title,
        heading=heading or title,
        question=question,
        answers=answers,
        sections=sections,
        scenarios=scenarios,
        footer=footer,
        style=files.joinpath("page.css").read_text(),
        program=files.joinpath("page.js").read_text(),
    )
    with atomic_write(path) as file:
        file.write(page.encode())


def _content(image: Path | Figure) -> bytes:
    if isinstance(image, Path):
        return image.read_bytes()
    file = io.BytesIO()
    with rc_context(RC):
        image.savefig(file, format="png", dpi=120)
    return file.getvalue()
