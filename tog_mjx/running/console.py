"""What every command shares: one clear line for bad input, and the compilation cache."""

import contextlib
import gc
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import jax

from tog_mjx.running.arguments import ArgumentParser as ArgumentParser
from tog_mjx.running.arguments import within as within
from tog_mjx.running.caches import CACHE_VARIABLE as CACHE_VARIABLE
from tog_mjx.running.caches import JAX_CACHE_VARIABLE, cache_folder, unwritable
from tog_mjx.running.devices import use_all_cores
from tog_mjx.running.errors import InputError, printable
from tog_mjx.running.interruption import Terminated, awaiting_interruptions, interruptible
from tog_mjx.running.quiet import without_remarks, without_warnings
from tog_mjx.running.user_code import own_lines
from tog_mjx.running.xla_flags import tune_compiler

SEEDS = 2**32 - 1
"""The largest seed: in float32 JAX would cut off what is beyond."""
GRID_MOST = 3000
"""Points of a landscape along each axis."""
CONTINUES = "what was finished is kept, the same command continues"
"""What most of those say that keep something when they are interrupted."""


def run_main(main: Callable[[], None], continues: str = "") -> None:
    """Runs a command: bad input ends it with one line and status 2, Ctrl-C with one and 130, SIGTERM with one and 143.

    Where a user's own code has failed, its lines stand before that line. `continues` tells after an interruption what
    is kept, and how to go on.
    """
    name = Path(sys.argv[0]).name
    with interruptible():
        try:
            _prepare()
            with without_warnings(), without_remarks(), awaiting_interruptions():
                main()
        except InputError as error:
            print(f"{own_lines(error.__cause__)}{name}: {printable(str(error))}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt as end:
            word, status = ("terminated", 143) if isinstance(end, Terminated) else ("interrupted", 130)
            print(f"{name}: {word}{continues and '; '}{continues}", file=sys.stderr)
            _leave(status)


def _prepare() -> None:
    enable_compilation_cache()
    use_all_cores()
    tune_compiler()
    # Tracing a step of MJX makes many objects and little garbage: a fifth of its time went into looking for some.
    gc.set_threshold(100_000)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # A name of a file need be no text in the terminal's encoding.
            stream.reconfigure(errors="backslashreplace")


def _leave(status: int) -> NoReturn:
    """Ends the program at once: XLA may be computing still, and crashes when Python is taken down under it."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(status)


def enable_compilation_cache() -> None:
    """Keeps compiled functions on disk, so that a second start need not compile. JAX_COMPILATION_CACHE_DIR wins."""
    folder = cache_folder()
    if folder is None or os.environ.get(JAX_CACHE_VARIABLE):
        return
    if complaint := unwritable(folder):
        name = Path(sys.argv[0]).name
        print(f"{name}: compiling without a cache: {folder} cannot be written ({complaint})", file=sys.stderr)
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
