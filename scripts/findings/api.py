"""Writes api.md, the public names on one page, from their docstrings: `python scripts/findings/api.py`."""

if __name__ == "__main__":  # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import ast
import importlib
import inspect
import re
import textwrap
from collections import namedtuple
from pathlib import Path
from typing import Any

import tog_mjx

PAGE = Path(__file__).with_suffix(".md")
GROUPS = {
    "Problems": "Problem Controls Start Parameters Policy Starts State Plane",
    "Costs and motions": "objective engines.Objective rollout Motion film engines.choose_engine engines.Choice",
    "In a program of MJX": "step simulate converged solver_error Parameter",
    "Can this gradient be trusted?": "check check_scene checks.told.finding.Verdict checks.told.finding.Finding",
    "Solving": "solve solving.descent.descend solving.descent.Descent solving.descent.Status",
    "Estimators of gradients": "gradients.exact gradients.exact_batch gradients.stochastic gradients.zeroth_order "
    "gradients.first_order gradients.mixed gradients.alpha_order gradients.mix gradients.alpha_order_mix gradients.Mix "
    "gradients.bernstein_radius gradients.common_starts gradients.central_differences "
    "gradients.differences.settled_differences gradients.differences.Differences",
    "Landscapes, and the paper's tasks": "landscape studies.landscape.Landscape studies.landscape.gradient_field "
    "studies.landscape.GradientField get_task Task",
    "Scenes": "load_scene Scene make_simulator",
    "Bad input": "InputError",
}
"""Where names stand on the page: those of `tog`, and those of a room of the package with the room before them."""
INTRODUCTION = """# The public names

Made by `scripts/findings/api.py` from the docstrings. `tog` is `import tog_mjx as tog`. These names are stable: what
changes is in [CHANGELOG.md](../../CHANGELOG.md), and an older name works for one version more, with a warning. All
other names, and the modules in which names stand, may change with any version.

Shapes are in brackets: n variables; nq, nv, na and nu positions, velocities, activations and controls of a model; T
moments; F fingers. Functions of JAX arrays run in the precision of JAX's x64 flag.
"""
LISTS, TEXTS = ("Args", "Attributes", "Returns", "Raises"), ("Units", "Gradient", "Source")
"""The parts of a docstring after its paragraphs: those with an item a name, and those of running text."""
Entry = namedtuple("Entry", "name node members")
"""A public name as one writes it, its source, and of a class its public functions."""


def public() -> list[str]:
    """All names of `tog`."""
    return [name for name in dir(tog_mjx) if name[0] != "_" and not inspect.ismodule(getattr(tog_mjx, name))]


def entry(name: str) -> Entry:
    room, _, own = f"tog_mjx.{name}".rpartition(".")
    source = inspect.getsource(inspect.unwrap(getattr(importlib.import_module(room), own)))
    node: Any = ast.parse(textwrap.dedent(source)).body[0]
    members = [part for part in node.body if isinstance(node, ast.ClassDef) and isinstance(part, ast.FunctionDef)]
    members = [part for part in members if not re.match("_(?!_call)", part.name) and "Older" not in decorators(part)]
    return Entry(f"tog.{own}" if room == "tog_mjx" else f"{room}.{own}", node, members)


def decorators(node: Any) -> str:
    return " ".join(map(ast.unparse, node.decorator_list))


def is_field(part: Any) -> bool:
    return isinstance(part, ast.AnnAssign) and ast.unparse(part)[0] != "_" and "ClassVar" not in ast.unparse(part)


def signature(name: str, node: Any, width: float = 110) -> str:
    """As one would call it, with annotations and defaults."""
    inner = [part for part in node.body if isinstance(node, ast.ClassDef)]
    made = [node, *(part for part in inner if getattr(part, "name", "") == "__init__")][-1]
    if isinstance(made, ast.FunctionDef):
        given = re.sub("^(self|cls)(, )?", "", ast.unparse(made.args).replace("=", " = "))
        parts = re.split(r", (?=\*|\w+: )", given)
        returns = f" -> {ast.unparse(made.returns)}" if made.returns and made is node else ""
    else:
        parts, returns = [ast.unparse(part) for part in inner if is_field(part)], ""
    line, lines = ", ".join(parts), "".join(f"\n    {part}," for part in parts) + "\n"
    return f"{name}({line if len(name + line + returns) < width else lines}){returns}".replace("'", '"')


def told(node: Any) -> str:
    """A docstring in Markdown: lists as lists, parts by their names, what is set in as code."""
    lines, part = [], ""
    for line in (ast.get_docstring(node) or "").splitlines():
        head = re.fullmatch(rf"({'|'.join(LISTS + TEXTS)}):(.*)", line)
        named = re.match(r"  (\w[\w*, ()]{0,40}): (.*)", line)
        part = head[1] if head else part if not line or line.startswith("  ") else ""
        if head:
            lines += ["", f"**{part}:**{head[2]}", *[""] * (part in LISTS)]
        elif part in LISTS and named:
            lines.append(f"- `{named[1]}`: {named[2]}")
        elif part:
            lines.append(f"  {line.strip()}".rstrip() if part in LISTS else line.strip())
        else:
            lines.append(f"  {line}" if re.match("  (?!  )", line) else line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def in_brief(member: Any) -> str:
    """A method's docstring in one line."""
    return " ".join((ast.get_docstring(member) or "").replace("Raises:", "").split())


def page() -> str:
    parts = [INTRODUCTION]
    for title, names in GROUPS.items():
        parts.append(f"## {title}\n")
        for name, node, members in map(entry, names.split()):
            parts += [f"### {name}\n", f"```python\n{signature(name, node)}\n```\n", told(node) + "\n"]
            for some in members:
                called = some.name if "property" in decorators(some) else signature(some.name, some, float("inf"))
                parts.append(f"- `{called}`: {in_brief(some)}")
            parts += [""] * bool(members)
    return "\n".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
