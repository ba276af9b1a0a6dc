"""The one exception for bad input, what is asked of arguments everywhere, and how it is told."""

import difflib
import operator
from collections.abc import Iterable
from typing import Any

MANY = 10_000_000
"""Of steps, iterations or points: more is a slip, and would run for ever."""


class InputError(ValueError):
    """Bad input, told in one line: what is wrong, where, and the remedy. Commands print it and exit with status 2."""


def require_kind(what: str, value: object, kinds: Any, remedy: str) -> None:
    """Raises InputError for what `isinstance` says is of another kind."""
    if not isinstance(value, kinds):
        raise InputError(f"{what} is of type {type(value).__name__}; {remedy}")


def require_choice(what: str, value: object, choices: Iterable[str]) -> None:
    """Raises InputError for what is not among the choices."""
    if value not in (choices := list(choices)):
        raise InputError(f"{what}={value!r} is unknown; choose from {', '.join(choices)}{near(value, choices)}")


def require_whole(what: str, value: Any, least: int, most: int = MANY) -> int:
    """The value as an int; raises InputError for what is none from `least` to `most`."""
    try:
        whole = operator.index(value)
    except TypeError:
        whole = least - 1
    if not least <= whole <= most:
        raise InputError(f"{what} is {value!r}: give a whole number from {least} to {most}")
    return whole


def near(wrong: object, choices: Iterable[str]) -> str:
    """ "; did you mean ctrl?" where one of the choices is spelt nearly so; else nothing."""
    found = difflib.get_close_matches(str(wrong), list(choices), 1)
    return f"; did you mean {found[0]}?" if found else ""


def printable(text: str) -> str:
    """The text in one line, and nothing in it that a terminal obeys: names in a scene may hold anything."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
