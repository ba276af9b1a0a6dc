"""The rooms of the package: each imports from itself and from those below it."""

import ast
from collections import Counter
from pathlib import Path

import tog_mjx

PACKAGE = Path(tog_mjx.__file__).parent
ROOMS = [
    "commands",
    "paper",
    "studies",
    "drawing",
    "checks",
    "solving",
    "engines",
    "problems",
    "mjcf",
    "stepping",
    "gradients",
    "running",
]
"""From the top floor down."""


def imports(file: Path) -> set[str]:
    """The rooms of this package that a file imports from."""
    nodes = list(ast.walk(ast.parse(file.read_text())))
    modules = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    modules += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return {module.split(".")[1] for module in modules if module.startswith("tog_mjx.")}


def test_imports_run_downward_only():
    assert sorted(path.name for path in PACKAGE.iterdir() if list(path.glob("*.py"))) == sorted(ROOMS)
    upward = {
        f"{file.relative_to(PACKAGE)} -> {room}"
        for i, name in enumerate(ROOMS)
        for file in (PACKAGE / name).rglob("*.py")
        for room in imports(file) - set(ROOMS[i:])
    }
    assert not upward


def test_a_file_name_stands_for_one_thing_and_no_file_is_long():
    files = [file for file in PACKAGE.rglob("*.py") if file.name != "__init__.py"]
    others = [file.name for file in files if file.parent.name != "commands"]  # Which are named as one types them.
    assert [name for name, count in Counter(others).items() if count > 1] == []
    assert [str(file) for file in PACKAGE.rglob("*.py") if len(file.read_text().splitlines()) > 300] == []
    assert len((PACKAGE / "__init__.py").read_text().splitlines()) <= 50
