"""What the changelog says of versions and older names is so."""

import re
import tomllib
from pathlib import Path

import tog_mjx
from tog_mjx.running.older_names import REMOVED_IN

ROOT = Path(__file__).parent.parent
CHANGELOG = (ROOT / "CHANGELOG.md").read_text()
VERSIONS = re.findall(r"^## (\S+) - \d{4}-\d{2}-\d{2}$", CHANGELOG, re.MULTILINE)


def numbers(version: str) -> list[int]:
    return [int(part) for part in version.split(".")]


def test_the_newest_version_is_the_packages():
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    citation = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert [VERSIONS[0], *citation] == [package, package]
    assert sorted(VERSIONS, key=numbers, reverse=True) == VERSIONS


def test_older_names_go_with_the_version_after_and_all_of_them_are_told():
    assert numbers(REMOVED_IN) > numbers(VERSIONS[0])
    told = re.findall(r"^### Deprecated\n(.*?)^###? ", CHANGELOG, re.MULTILINE | re.DOTALL)[0]
    source = "\n".join(file.read_text() for file in Path(tog_mjx.__file__).parent.rglob("*.py"))
    decorators = re.findall(r"^@older_keywords\((.*)\)", source, re.MULTILINE)
    keywords = re.findall(r"\w+=", " ".join(decorators))
    attributes = re.findall(r"@OlderAttribute\.of\(.*\)\n +def (\w+)", source)
    names = re.findall(r"^__getattr__ = _older_names\(.*\{\"(\w+)\"", source, re.MULTILINE)
    assert (len(set(keywords)), len(attributes), len(names)) == (3, 3, 1)
    assert [name for name in {*keywords, *attributes, *names} if not re.search(rf"`(tog\.)?{name}`", told)] == []
    assert f"go with {REMOVED_IN}" in told
