"""A user's own code: where it fails that is bad input, told in one line, after its own lines in which it happened."""

import importlib
import operator
import os
import runpy
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import mujoco
from jaxtyping import Array

from tog_mjx.running.errors import InputError, near

_OURS = Path(__file__).parents[1]
_OTHERS = tuple(
    f"{folder}{os.sep}"
    for folder in (_OURS, *(Path(str(some.__file__)).parent for some in (jax, jaxtyping, mujoco, importlib)))
)
"""Folders of code that may stand between a user's and what failed."""
_TRACED = jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError
"""What JAX raises where a number is asked for that it has not yet."""
_PYTHON = f"{Path(os.__file__).parent}{os.sep}"
"""Python's own; where others' packages are in a folder within it, that is no part of it."""


def call(what: str, function: Callable, *args: Any) -> Any:
    """`function(*args)`.

    Raises:
      InputError: `what`, and why, for whatever the function raises, and where it ends the program; that error is its
        cause.
    """
    try:
        return function(*args)
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit):
            why = f"it calls sys.exit({error.code!r})"
        elif isinstance(error, InputError):
            why = str(error)
        else:
            why = f"{type(error).__name__}: {error}".strip().splitlines()[0]
        if isinstance(error, _TRACED):
            why += "; compute with jax.numpy in place of numpy and float(), and choose by jnp.where in place of if"
        raise InputError(f"{what}: {why}") from error


def load(what: str, name: str) -> Callable:
    """The function that "package.module:function" or "path/file.py:function" names; modules of the working folder are
    found too.

    Raises:
      InputError: of `what`, if it cannot be imported, or is no function.
    """
    module, _, function = name.rpartition(":")
    if not module or not function:
        raise InputError(f"{what} {name!r}: give package.module:function or file.py:function")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    inside = call(f"{what} {name!r} cannot be imported", _module, module)
    try:
        found = operator.attrgetter(function)(inside)
    except AttributeError:
        functions = [some for some, value in vars(inside).items() if callable(value) and some[0] != "_"]
        raise InputError(f"{what} {name!r}: {module} has no {function}{near(function, functions)}") from None
    if not callable(found):
        raise InputError(f"{what} {name!r} is no function but a {type(found).__name__}")
    return found


def _module(name: str) -> Any:
    if not name.endswith(".py"):
        return importlib.import_module(name)
    return SimpleNamespace(**runpy.run_path(name))


def real(what: str, value: Any, wanted: str) -> Array:
    """What a user's function has returned, as an array of floats of its shape.

    Raises:
      InputError: `what` and that it is `wanted`, for anything that is no array of real numbers.
    """
    try:
        array = None if value is None else jnp.asarray(value)
    except (TypeError, ValueError):
        array = None
    if array is None:
        raise InputError(f"{what} returns a {type(value).__name__}; give {wanted}")
    if jnp.iscomplexobj(array):
        raise InputError(f"{what} returns a complex number; give a real one")
    if not jnp.issubdtype(array.dtype, jnp.floating):
        raise InputError(f"{what} returns {array.dtype}, which has no derivative; give {wanted}")
    return array


def number(what: str, function: Callable, *args: Any) -> Array:
    """`function(*args)`, a real number [].

    Raises:
      InputError: of `what`, if it fails or returns none.
    """
    found = real(what, call(f"{what} fails", function, *args), "one number")
    if found.size != 1:
        raise InputError(f"{what} returns an array of shape {list(found.shape)}; give one number")
    return found.reshape(())


def own_lines(error: BaseException | None) -> str:
    """Where in a user's own code an error was raised, and what it came from, as Python prints it; empty where no user's
    code has a part."""
    users = list[traceback.FrameSummary]()
    while error:
        users += [frame for frame in traceback.extract_tb(error.__traceback__) if _is_users(frame.filename)]
        error = error.__cause__
    return "".join(traceback.format_list(users))


def _is_users(file: str) -> bool:
    is_python = file.startswith(_PYTHON) and not file.startswith(f"{_PYTHON}site-packages{os.sep}")
    return not (is_python or file.startswith((*_OTHERS, "<")))
