"""The page of errors and the tests that it names."""

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "scripts" / "findings" / "errors.md").read_text()
_, *ENTRIES = re.split(r"^## ", PAGE, flags=re.MULTILINE)


@functools.cache
def functions_of(file: str) -> set[str]:
    tree = ast.parse((ROOT / file).read_text())
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def named(text: str) -> set[tuple[str, str]]:
    return set(re.findall(r"`(tests/test_\w+\.py)::(\w+)`", text))


def test_each_entry_names_tests_that_exist_and_what_to_do():
    assert len(ENTRIES) > 20
    for entry in ENTRIES:
        assert named(entry), entry.splitlines()[0]
        for file, test in named(entry):
            assert test in functions_of(file), f"{file}::{test}"
        assert re.search(r"^(Mend|Instead): ", entry, re.MULTILINE), entry.splitlines()[0]


def test_each_test_of_an_error_is_told():
    file = "tests/test_errors.py"
    assert {(file, test) for test in functions_of(file)} <= named(PAGE)
