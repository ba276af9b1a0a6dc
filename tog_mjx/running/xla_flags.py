"""Settings of XLA, JAX's compiler, in the environment variable `XLA_FLAGS`.

XLA ends the process on a flag that it does not know, and each release of jaxlib knows others. No part of jaxlib lists
them, and to read the variable once is to be past changing it: so jaxlib is asked in a process of its own (0.2 s), where
the answer is not known.
"""

import functools
import os
import re
import subprocess
import sys

import jaxlib.version

from tog_mjx.running.errors import InputError

_SETTINGS = {
    "xla_backend_extra_options": "xla_cpu_small_while_loop_byte_threshold=1000000",
    "xla_cpu_use_fusion_emitters": "false",
}
_TAKEN_BY = ("0.10.2",)
"""Versions of jaxlib that take these."""


def tune_compiler() -> None:
    """Two settings of XLA's CPU compiler, where jaxlib knows them and nobody chose. No effect once JAX has started.

    - A time loop over little data becomes one machine function. By default XLA in JAX 0.10 does so below 1 kB, and runs
      larger loops kernel by kernel: on one motion of `penalty` that takes 3 times as long, on its gradient in reverse
      mode ten times. MJX's loops hold calls to LAPACK and stay as they are.
    - The older code generator of fused operations: it compiles a gradient through MJX in less than two thirds of the
      time and runs it no slower; a batch on `penalty` may lose a fifth. JAX 0.12 has only the newer one.

    Raises:
      InputError: for an `XLA_FLAGS` of the user's that jaxlib refuses.
    """
    chosen = os.environ.get("XLA_FLAGS", "")
    is_file = chosen.strip() and not chosen.lstrip().startswith("-")  # A file of flags: nothing can be added.
    ours = {} if is_file else {name: value for name, value in _SETTINGS.items() if name not in chosen}
    while complaint := _complaint(_join(chosen, ours)):
        known = {name: value for name, value in ours.items() if name not in complaint}
        if known == ours:
            raise InputError(f"jaxlib {jaxlib.version.__version__} refuses XLA_FLAGS='{chosen}': {complaint}")
        ours = known
    os.environ["XLA_FLAGS"] = _join(chosen, ours)


def _join(chosen: str, ours: dict[str, str]) -> str:
    return " ".join([chosen, *(f"--{name}={value}" for name, value in ours.items())]).strip()


@functools.lru_cache
def _complaint(flags: str) -> str:
    """What jaxlib says against these flags in the line with which it ends; empty if it takes them."""
    if flags == _OURS and jaxlib.version.__version__ in _TAKEN_BY:
        return ""
    asked = subprocess.run(
        [sys.executable, "-c", "from jaxlib import xla_client; xla_client.CompileOptions()"],
        env=os.environ | {"XLA_FLAGS": flags},
        capture_output=True,
        text=True,
    )
    said = re.search(r"^[EF]\d{4} [^]]*\] (.*)$", asked.stderr, re.MULTILINE)
    return said[1] if asked.returncode and said else ""


_OURS = _join("", _SETTINGS)
