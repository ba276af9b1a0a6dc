"""MJX, imported quietly, and only in a version that this package has been checked against.

MJX prints to standard output on import (that the optional Warp is not installed); a program's standard output is its
own. And `tog_mjx.constraints` reads fields that MJX keeps private, which another version may rename or redefine.
"""

import contextlib
import importlib.metadata
import io

OLDEST, NEXT = (3, 17), (4, 0)


def check_version(version: str) -> None:
    """Raises ImportError, with the remedy, for a version of mujoco-mjx outside [OLDEST, NEXT)."""
    if not OLDEST <= tuple(int(part) for part in version.split(".")[:2]) < NEXT:
        wanted = f">={'.'.join(map(str, OLDEST))},<{'.'.join(map(str, NEXT))}"
        raise ImportError(
            f"mujoco-mjx {version} is installed, tog_mjx needs {wanted}: pip install 'mujoco-mjx{wanted}'"
        )


check_version(importlib.metadata.version("mujoco-mjx"))
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx as mjx
