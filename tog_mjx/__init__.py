"""tog_mjx: exact against stochastic gradients through contact, on MuJoCo MJX."""

import importlib
import importlib.util
import os
from typing import TYPE_CHECKING, Any

if os.environ.get("MUJOCO_GL"):  # First of all: what follows imports MuJoCo, and that OpenGL may not work.
    from tog_mjx.running import _mujoco as _mujoco

if TYPE_CHECKING:
    from tog_mjx.api import *  # noqa: F403
else:

    def __getattr__(name: str) -> Any:
        """A room, or a public name. All of these are loaded when one is asked for: with JAX that takes two seconds, and
        `tog --help` needs none."""
        if name == "__all__":
            return __dir__()
        if name.startswith("_"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if importlib.util.find_spec(f"{__name__}.{name}"):
            return importlib.import_module(f"{__name__}.{name}")
        globals().update({public: getattr(_api(), public) for public in __dir__()})
        return globals()[name] if name in globals() else getattr(_api(), name)

    def __dir__() -> list[str]:
        return [name for name in vars(_api()) if not name.startswith("_")]

    def _api() -> Any:
        return importlib.import_module(f"{__name__}.api")
