"""MuJoCo without its warnings, where what is wrong is told otherwise."""

import contextlib
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
