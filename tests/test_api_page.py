"""The page of public names is made from docstrings that hold what a reader asks for; nothing here compiles."""

import ast
import functools
import importlib
import inspect
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

PROGRAM = Path(__file__).parent.parent / "scripts" / "findings" / "api.py"
API = runpy.run_path(str(PROGRAM))
ENTRIES = [API["entry"](name) for names in API["GROUPS"].values() for name in names.split()]
DIFFERENTIABLE = {
    "Array",
    "AnyArray",
    "Bound",
    "Data",
    "Estimator",
    "Motion",
    "Numbers",
    "Objective",
    "Scalar",
    "Simulator",
}
"""Types of what JAX differentiates; `mjx.Data` and such are known by their last name."""
ARRAYS = DIFFERENTIABLE | {"ndarray", "Descent", "Differences", "Landscape"}
JUDGED = {"Descent", "Verdict"}
EDGES = ("touch-down", "rest", "limit", "kink")
"""What a gradient of a motion is asked about; one of a function of one's own is asked about its jumps and kinks."""
SHAPE = re.compile(r"(?<!\w)\[(\.\.\., )?[\w*+ ]+(, [\w*+ ]+)*\]")


def types(node: Any) -> set[str]:
    """Names in the annotations of what a function takes and returns; of a class, of its fields and public members."""
    if isinstance(node, ast.FunctionDef):
        given = [*node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg]
        annotations = [some.annotation for some in given if some] + [node.returns]
    else:
        annotations = [
            some.annotation for some in node.body if isinstance(some, ast.AnnAssign) and API["is_field"](some)
        ]
    parts = [part for some in annotations if some for part in ast.walk(some)]
    return {part.id if isinstance(part, ast.Name) else getattr(part, "attr", "") for part in parts}


def of_all(entry: Any) -> set[str]:
    return set().union(types(entry.node), *map(types, entry.members))


@functools.cache
def private(module: str) -> list[ast.FunctionDef]:
    """The functions of a module that only it calls."""
    tree = ast.walk(ast.parse(inspect.getsource(importlib.import_module(module))))
    return [some for some in tree if isinstance(some, ast.FunctionDef) and some.name.startswith("_")]


def raises(node: Any, module: str, seen: frozenset[str] = frozenset()) -> bool:
    """Whether it raises InputError itself, or by private functions of its module, or by those that ask for it."""
    text = ast.unparse(node)
    if re.search(r"raise InputError|\b(require|check)_\w+\(|user_code\.|\bcall\(", text):
        return True
    called = [some for some in private(module) if some.name not in seen and re.search(rf"\b{some.name}\(", text)]
    return any(raises(some, module, seen | {some.name}) for some in called)


def own(entry: Any) -> Any:
    """Of a class what happens when one is made."""
    if isinstance(entry.node, ast.FunctionDef):
        return entry.node
    made = [some for some in entry.node.body if getattr(some, "name", "") in ("__init__", "__post_init__")]
    return ast.Module(made, [])


def part(entry: Any, name: str) -> str:
    """A docstring's line of that name, in one."""
    found = re.search(rf"^{name}: (.*(\n  .*)*)", ast.get_docstring(entry.node) or "", re.MULTILINE)
    return " ".join(found[1].split()) if found else ""


GRADIENTS = {entry.name: part(entry, "Gradient") for entry in ENTRIES}


def module_of(entry: Any) -> str:
    room, _, name = entry.name.replace("tog.", "tog_mjx.").rpartition(".")
    return getattr(importlib.import_module(room), name).__module__


def tells_edges(entry: Any) -> bool:
    """Of all edges itself, or by the name of one that does."""
    told = GRADIENTS[entry.name]
    if entry.name.startswith("tog_mjx.gradients"):
        return told.startswith("none") or ("jump" in told and "kink" in told)
    named = [GRADIENTS[name] for name in re.findall(r"`(tog[\w.]+)`", told) if name in GRADIENTS]
    return told.startswith("none") or any(all(edge in some for edge in EDGES) for some in [told, *named])


RULES = {
    "says what it is": (lambda entry: entry.name, lambda entry: ast.get_docstring(entry.node)),
    "gives shapes of its arrays": (
        lambda entry: of_all(entry) & ARRAYS,
        lambda entry: SHAPE.search(API["told"](entry.node)),
    ),
    "gives units, or whose they are": (lambda entry: of_all(entry) & ARRAYS, lambda entry: part(entry, "Units")),
    "says when it raises InputError": (
        lambda entry: raises(own(entry), module_of(entry)),
        lambda entry: re.search(r"^Raises:\n  InputError: \w+", ast.get_docstring(entry.node) or "", re.MULTILINE),
    ),
    "says its gradient": (lambda entry: of_all(entry) & DIFFERENTIABLE, lambda entry: part(entry, "Gradient")),
    "says its gradient at edge cases": (lambda entry: part(entry, "Gradient"), tells_edges),
    "says where it is from": (
        lambda entry: (
            isinstance(entry.node, ast.FunctionDef) and (part(entry, "Gradient") or types(entry.node) & JUDGED)
        ),
        lambda entry: part(entry, "Source"),
    ),
}
"""A part that a docstring has: of which names, and what is looked for."""


@pytest.mark.parametrize("rule", RULES)
def test_every_public_name(rule):
    asked, found = RULES[rule]
    lacking = [entry.name for entry in ENTRIES if asked(entry) and not found(entry)]
    assert not lacking, f"each of these {rule}"


def test_every_member_is_told_in_brief_and_says_when_it_raises():
    members = [(entry, member) for entry in ENTRIES for member in entry.members]
    assert [f"{entry.name}.{some.name}" for entry, some in members if not API["in_brief"](some)] == []
    silent = [
        f"{entry.name}.{some.name}"
        for entry, some in members
        if raises(some, module_of(entry)) and "InputError" not in API["in_brief"](some)
    ]
    assert silent == []


def test_the_page_has_every_public_name():
    assert {entry.name for entry in ENTRIES} >= {f"tog.{name}" for name in API["public"]()}


def test_the_page_is_made_of_the_docstrings():
    assert API["PAGE"].read_text() == API["page"](), "run python scripts/findings/api.py"
