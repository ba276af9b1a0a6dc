"""The folder in which compiled functions are kept between runs. It needs no JAX."""

import os
import tempfile
from pathlib import Path

CACHE_VARIABLE = "TOG_MJX_CACHE"
"""Environment variable: the folder of compiled functions, or "off". The default lies in the user's cache folder."""
JAX_CACHE_VARIABLE = "JAX_COMPILATION_CACHE_DIR"
"""JAX's own, which wins."""


def cache_folder() -> Path | None:
    """None where nothing is kept."""
    wish, of_jax = os.environ.get(CACHE_VARIABLE), os.environ.get(JAX_CACHE_VARIABLE)
    if of_jax:
        return Path(of_jax)
    if (wish or "").lower() == "off":
        return None
    root = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 (Path.home() may raise)
    return Path(wish or Path(root) / "tog_mjx")


def unwritable(folder: Path) -> str:
    """Why no file can be written into the folder, which is made where it is missing; empty where one can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""
