"""Ctrl-C and SIGTERM end a script wherever Python is when they come.

Python runs a signal's handler between two instructions of the main thread, and what it raises there is lost where
exceptions are: in callbacks of the garbage collector, of which JAX has one, in `__del__`, and in callbacks from C. Then
the signal comes again a moment later, as it does where JAX makes an error of its own of it. While the main thread waits
in JAX for another one the handler waits too, and what that thread computes asks `has_come`.
"""

import _thread
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

_SOON = 0.01
"""Seconds until a signal that was lost comes again."""
_NONE = 0
_coming, _come = threading.Event(), threading.Event()


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
        with _watching():
            yield
    finally:
        sys.unraisablehook = report
        if has_timer:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for some, handler in before.items():
            signal.signal(some, handler)


@contextlib.contextmanager
def _watching() -> Iterator[None]:
    """Python writes each signal's number as it comes, whatever the main thread does."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)

    def watch() -> None:
        while (number := os.read(read, 1)[0]) != _NONE:
            if number in (signal.SIGINT, signal.SIGTERM):
                _come.set()

    watcher = threading.Thread(target=watch, name="signals", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.write(write, bytes([_NONE]))
        watcher.join()
        os.close(read)
        os.close(write)
        _come.clear()


def has_come() -> bool:
    """Has a signal come to end this script, which its main thread may not know yet?"""
    return _come.is_set()


def come_again(interruption: KeyboardInterrupt) -> None:
    """Lets an interruption that is raised where JAX makes an error of its own of it come again, in any program."""

    def again() -> None:
        _thread.interrupt_main(signal.SIGTERM if isinstance(interruption, Terminated) else signal.SIGINT)
        _coming.clear()

    _coming.set()
    timer = threading.Timer(_SOON, again)
    timer.daemon = True
    timer.start()


@contextlib.contextmanager
def awaiting_interruptions() -> Iterator[None]:
    """No error leaves before the interruption that it is made of."""
    try:
        yield
    finally:
        while _coming.is_set():
            time.sleep(_SOON)
