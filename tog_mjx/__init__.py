"""tog_mjx: exact against stochastic gradients through contact, on MuJoCo MJX."""

import ast
import functools
import importlib
import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if os.environ.get("MUJOCO_GL"):  # First of all: what follows imports MuJoCo, and that OpenGL may not work.
    from tog_mjx.running import _mujoco as _mujoco

if TYPE_CHECKING:
    from tog_mjx.api import *  # noqa: F403
else:

    def __getattr__(name: str) -> Any:
        """A room, or a public name: loaded when it is asked for, with what it needs alone. JAX takes a second, and
        `tog --help` needs none; MJX takes half of one, and optax a tenth, and C MuJoCo needs neither."""
        if name == "__all__":
            return __dir__()
        if name.startswith("_"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if importlib.util.find_spec(f"{__name__}.{name}"):
            return importlib.import_module(f"{__name__}.{name}")
        if name in _homes():
            globals()[name] = getattr(importlib.import_module(_homes()[name]), name)
            return globals()[name]
        return getattr(importlib.import_module(f"{__name__}.api"), name)  # By its older name, or none.

    def __dir__() -> list[str]:
        return list(_homes())

    @functools.cache
    def _homes() -> dict[str, str]:
        """The modules of the public names, as `api` imports them: its text is read, as running it would load all."""
        lines = ast.parse((Path(__file__).parent / "api.py").read_text()).body
        froms = [line for line in lines if isinstance(line, ast.ImportFrom) and line.module]
        names = {(some.asname, line.module) for line in froms for some in line.names if some.name == some.asname}
        return dict(sorted(names))
