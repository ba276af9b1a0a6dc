"""MuJoCo without its warnings, and other libraries without theirs, where what is wrong is told otherwise."""

import contextlib
import logging
import sys
import warnings
from collections.abc import Iterator

import mujoco


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """C MuJoCo prints no warning and writes no log file into the working folder; afterwards it does as before."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@contextlib.contextmanager
def without_remarks() -> Iterator[None]:
    """Numbers that overflow are not warned of, and Matplotlib and JAX neither warn nor log what is no error; afterwards
    they do as before. Whoever asks for warnings, as by `python -W`, gets all."""
    if sys.warnoptions:
        yield
        return
    loggers = [logging.getLogger(name) for name in ("jax", "matplotlib")]
    before = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=RuntimeWarning)
        warnings.filterwarnings("ignore", module="matplotlib|jax")
        for logger in loggers:
            logger.setLevel(max(logger.level, logging.ERROR))
        try:
            yield
        finally:
            for logger, level in zip(loggers, before, strict=True):
                logger.setLevel(level)
