"""MJX, imported without its print to standard output (it reports there that the optional Warp is not installed)."""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx as mjx
