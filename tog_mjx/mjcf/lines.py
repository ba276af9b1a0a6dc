"""Where the elements of a compiled model are written: file and line.

A named element is found by its name. One without a name is found by its order in its body, or in its section of the
file, where the file has as many of them as the model; where it has not (replicated or attached elements, or such as
the compiler discards), by the nearest body that can be found. A model that is not from an MJCF file has no lines.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import mujoco

_SECTIONS = {"actuator": "actuator", "sensor": "sensor", "equality": "equality", "tendon": "tendon", "pair": "contact"}
"""The section of the file that holds the elements of a kind, in the order of the model."""
_IN_BODIES = {"geom": ("geom",), "joint": ("joint", "freejoint"), "body": ("body",)}
"""The tags of what belongs to a body."""
_TRANSPARENT = ("frame", "replicate")
"""Elements that hold bodies and geoms, and are no bodies themselves."""
_COUNTS = {"actuator": "nu", "sensor": "nsensor", "equality": "neq", "tendon": "ntendon", "pair": "npair"}


@dataclass
class Element:
    """An element of the file: its tag, its attributes, where it is, and what it holds."""

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list["Element"] = field(default_factory=list)

    @property
    def place(self) -> str:
        """`scene.xml:12`."""
        return f"{self.file.name}:{self.line}"

    def descendants(self, tags: tuple[str, ...], through: tuple[str, ...] = ()) -> Iterator["Element"]:
        """Elements of these tags among the children, and in children of the tags `through`, in order."""
        for child in self.children:
            if child.tag in tags:
                yield child
            if child.tag in through:
                yield from child.descendants(tags, through)


class Lines:
    """The lines of an MJCF file and of what it includes. Without lines where there is no such file."""

    def __init__(self, model: mujoco.MjModel, path: str | Path | None):
        self._model = model
        root = None if path is None else _read(Path(path), Path(path).parent)
        self._root = root if root is not None and root.tag == "mujoco" else None

    def place(self, kind: str, i: int) -> str:
        """`scene.xml:12` of the i-th element of a kind, or of the nearest body found; empty where there is none."""
        found = self._element(kind, i)
        return found.place if found else ""

    def place_of_option(self, attribute: str) -> str:
        """As `place`, of the option or the flag of this name; empty where the file does not give it."""
        given: list[Element] = []
        for option in self._section("option"):
            given += [some for some in (option, *option.children) if attribute in some.attributes]
        return given[-1].place if given else ""  # Of several the last counts.

    def _section(self, tag: str) -> list[Element]:
        return [] if self._root is None else [child for child in self._root.children if child.tag == tag]

    def _element(self, kind: str, i: int) -> Element | None:
        if self._root is None:
            return None
        if kind in _IN_BODIES:
            return self._in_body(kind, i)
        elements = [some for section in self._section(_SECTIONS[kind]) for some in section.children]
        if kind == "pair":
            elements = [some for some in elements if some.tag == "pair"]
        name = _name(self._model, kind, i)
        if name:
            return next((some for some in elements if some.attributes.get("name") == name), None)
        return elements[i] if len(elements) == getattr(self._model, _COUNTS[kind]) else None

    def _in_body(self, kind: str, i: int) -> Element | None:
        """A geom, a joint or a body; or the body that holds it, where the order tells nothing."""
        if kind == "body" and i == 0:
            return next(iter(self._section("worldbody")), None)
        if name := _name(self._model, kind, i):
            everywhere = (*_TRANSPARENT, "body")
            for world in self._section("worldbody"):
                for some in world.descendants(_IN_BODIES[kind], everywhere):
                    if some.attributes.get("name") == name:
                        return some
        parent, siblings = _siblings(self._model, kind, i)
        body = self._in_body("body", parent)
        if body is None:
            return None
        holders = self._section("worldbody") if parent == 0 else [body]
        elements = [some for holder in holders for some in holder.descendants(_IN_BODIES[kind], _TRANSPARENT)]
        return elements[siblings.index(i)] if len(elements) == len(siblings) else body


def _siblings(model: mujoco.MjModel, kind: str, i: int) -> tuple[int, list[int]]:
    """The body that holds an element, and all of this kind that it holds, in order."""
    holders = {"geom": model.geom_bodyid, "joint": model.jnt_bodyid, "body": model.body_parentid}[kind]
    parent = int(holders[i])
    first = 1 if kind == "body" else 0  # The world is its own parent.
    return parent, [j for j in range(first, len(holders)) if holders[j] == parent]


def _name(model: mujoco.MjModel, kind: str, i: int) -> str:
    return getattr(model, kind)(i).name


def _read(path: Path, folder: Path) -> Element | None:
    """The root of a file, with what it includes in the place of the inclusions; None for what is no XML.

    Paths of inclusions are relative to the folder of the main file.
    """
    parser = expat.ParserCreate()
    stack = [Element("", {}, path, 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, path, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)
        if tag == "include" and (included := _read(folder / attributes.get("file", ""), folder)):
            stack[-2].children[-1:] = included.children

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    try:
        parser.Parse(path.read_bytes(), True)
    except (expat.ExpatError, OSError):
        return None
    return next(iter(stack[0].children), None)
