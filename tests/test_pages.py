"""The pages of findings name no number that their CSV and JSON files do not hold."""

import json
import re
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "scripts" / "findings"
PAGES = sorted(path.stem for path in FOLDER.glob("*.md"))
MADE = ("api", "errors")
"""Pages whose numbers others hold: one is made from docstrings, the other is a list of tests."""
STATED = json.loads((FOLDER / "stated.json").read_text())
"""Numbers that no table of a program holds: page -> section -> what it is -> the number."""

NUMBER = re.compile(r"(?<![\w.,])-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|[.,]\d)")
MEASURED = re.compile(r"\.\d|e[-+]?\d|^\s*(?:%|(?:s|ms|us|MB|GB|times)\b)")
"""What a number, or what follows it, looks like that somebody measured. Whole ones without a unit count things."""
NOT_TEXT = re.compile(
    r"^```.*?^```|`[^`]*`|\]\([^)]*\)|^#.*?$|(?:Figures?|Table|JAX|Python|arXiv) *:?[\d.]+", re.MULTILINE | re.DOTALL
)


def sections(page: str) -> dict[str, str]:
    """Heading -> text, of the parts of the second level; what comes before the first has no heading."""
    first, *parts = re.split(r"^## ", (FOLDER / f"{page}.md").read_text(), flags=re.MULTILINE)
    return {"": first, **{part.partition("\n")[0]: part.partition("\n")[2] for part in parts}}


def said(text: str) -> list[str]:
    text = NOT_TEXT.sub(" ", text)
    matches = [(match.group(), text[match.end() : match.end() + 6]) for match in NUMBER.finditer(text)]
    return [number for number, rest in matches if MEASURED.search(number) or MEASURED.search(rest)]


def numbers_in(value: Any) -> list[float]:
    """All of a JSON value, those that its texts say too."""
    if isinstance(value, dict | list):
        return [n for item in (value.values() if isinstance(value, dict) else value) for n in numbers_in(item)]
    if isinstance(value, str):
        return [float(number.replace(",", "")) for number in NUMBER.findall(value)]
    return [float(value)] if isinstance(value, int | float) else []


@cache
def held_by(name: str) -> np.ndarray:
    path = FOLDER / name
    value = json.loads(path.read_text()) if path.suffix == ".json" else pd.read_csv(path).to_numpy(object).tolist()
    return np.asarray(numbers_in(value))


def is_held(number: str, held: np.ndarray) -> bool:
    """To the digits that are written, and as a share, a percentage or a size without its sign."""
    written = Decimal(number.replace(",", ""))
    half = 0.5001 * 10.0 ** int(written.as_tuple().exponent)
    return any((np.abs(factor * held - float(written)) <= half).any() for factor in (1, -1, 100))


def parts() -> list[tuple[str, str]]:
    return [(page, heading) for page in PAGES if page not in MADE for heading in sections(page)]


@pytest.mark.parametrize(("page", "heading"), parts())
def test_every_number_is_one_of_those_kept(page, heading):
    text = sections(page)[heading]
    stated = numbers_in(STATED.get(page, {}).get(heading, {}))
    files = re.findall(r"\]\((\w+\.(?:csv|json))\)", text)
    held = np.concatenate([stated, *(held_by(name) for name in files)])
    assert [number for number in said(text) if not is_held(number, held)] == []


@pytest.mark.parametrize("page", STATED)
def test_no_stated_number_is_left_over(page):
    assert set(STATED[page]) <= set(sections(page))
    for heading, numbers in STATED[page].items():
        text = [float(number.replace(",", "")) for number in said(sections(page)[heading])]
        assert set(numbers_in(list(numbers.values()))) <= set(text), heading
