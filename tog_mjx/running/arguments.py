"""What every command takes its arguments with. It needs no JAX."""

import argparse
import re
from collections.abc import Callable
from typing import Any, NoReturn

from tog_mjx.running.errors import near, printable


class ArgumentParser(argparse.ArgumentParser):
    """argparse's, saying in one line on standard error what is wrong."""

    def error(self, message: str) -> NoReturn:
        if found := re.search(r"invalid choice: '(.+)' \(choose from (.+)\)", message):
            message += near(found[1], re.findall(r"[^\s,']+", found[2]))
        self.exit(2, f"{self.prog}: {printable(message)} (see --help)\n")


def within(kind: Callable[[str], Any], low: int | float, high: int | float) -> Callable[[str], Any]:
    """A parser of numbers from `low` to `high`."""

    def number(text: str) -> Any:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not from {low} to {high}")
        return value

    number.__name__ = kind.__name__  # argparse names it where `kind` fails.
    return number
