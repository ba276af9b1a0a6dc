"""Names of the version before: they work for one version more, and whoever uses one is told the new one."""

import functools
import inspect
import traceback
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from tog_mjx.running.errors import InputError

REMOVED_IN = "0.3.0"
"""Every older name goes with that version."""
Function = TypeVar("Function", bound=Callable[..., Any])


def warn(older: str, newer: str) -> None:
    """A DeprecationWarning where code of another package uses `older`: Python shows it to whoever wrote that."""
    frames = traceback.walk_stack(inspect.currentframe())
    outside = (level for level, (frame, _) in enumerate(frames, 1) if not _is_ours(frame.f_globals.get("__name__", "")))
    told = f"{older} is the older name of {newer}, and goes with tog_mjx {REMOVED_IN}"
    warnings.warn(told, DeprecationWarning, stacklevel=next(outside, 1))


def _is_ours(module: str) -> bool:
    return module.split(".")[0] in ("tog_mjx", "jaxtyping")  # The latter wraps functions, in tests.


def older_keywords(**newer: str) -> Callable[[Function], Function]:
    """A decorator: the function takes keywords by their older names too, `older_keywords(simulator="engine")`.

    The function raises InputError where both are given.
    """

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def call(*args: Any, **given: Any) -> Any:
            for old, new in newer.items():
                if old not in given:
                    continue
                if new in given:
                    raise InputError(f"{old}= is the older name of {new}=; give the latter alone")
                warn(f"{old}=", f"{new}=")
                given[new] = given.pop(old)
            return function(*args, **given)

        return call  # type: ignore[return-value]

    return decorate


class OlderAttribute:
    """An attribute by its older name, which is that of the function: `@OlderAttribute.of("best")`."""

    def __init__(self, newer: str, value: Callable[[Any], Any]):
        self._newer, self._value = newer, value

    @classmethod
    def of(cls, newer: str) -> Callable[[Callable[[Any], Any]], Any]:
        return functools.partial(cls, newer)

    def __get__(self, owner: Any, kind: type | None = None) -> Any:
        if owner is None:
            return self
        warn(self._value.__name__, self._newer)
        return self._value(owner)


def older_names(module: str, newer: Mapping[str, Any]) -> Callable[[str], Any]:
    """The `__getattr__` of a module: its objects by their older names."""

    def find(name: str) -> Any:
        if name not in newer:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn(f"{module}.{name}", f"{module}.{newer[name].__name__}")
        return newer[name]

    return find
