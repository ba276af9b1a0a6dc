"""Ctrl-C and SIGTERM end a script wherever Python is when they come.

Python runs a signal's handler between two instructions of the main thread, and what it raises there is lost where
exceptions are: in callbacks of the garbage collector, of which JAX has one, in `__del__`, and in callbacks from C. Then
the signal comes again a moment later.
"""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

_SOON = 0.01
"""Seconds until a signal that was lost comes again."""


class Terminated(KeyboardInterrupt):
    """SIGTERM has come."""


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, and SIGTERM Terminated, and neither is lost. A signal that was ignored before,
    as Ctrl-C is in a job in the background, stays so; outside the main thread all is as it was."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    lost, report = KeyboardInterrupt, sys.unraisablehook

    def hook(dropped: Any) -> None:
        nonlocal lost
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report(dropped)
            return
        lost = dropped.exc_type
        signal.setitimer(signal.ITIMER_REAL, _SOON)

    def again(_: int, frame: FrameType | None) -> None:
        while frame is not None:
            if (frame.f_code.co_filename, frame.f_code.co_name) == (__file__, "hook"):  # It would be lost again.
                signal.setitimer(signal.ITIMER_REAL, _SOON)
                return
            frame = frame.f_back
        raise lost

    def terminate(*_: Any) -> None:
        raise Terminated

    handlers: dict[int, Callable] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: terminate}
    if has_timer := hasattr(signal, "setitimer"):
        handlers[signal.SIGALRM] = again
        sys.unraisablehook = hook
    usual = (signal.SIG_DFL, signal.default_int_handler)
    before = {some: now for some in handlers if (now := signal.getsignal(some)) in usual}
    for some in before:
        signal.signal(some, handlers[some])
    try:
        yield
    finally:
        sys.unraisablehook = report
        if has_timer:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for some, handler in before.items():
            signal.signal(some, handler)
