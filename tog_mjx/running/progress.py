"""Progress of what takes its time."""

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_SECONDS_BETWEEN_LINES = 10


class Work:
    """Progress of a list of pieces of work: a bar with the time left on a terminal, elsewhere a line now and then."""

    def __init__(self, console: Console):
        self.console = console
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bars = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)

    @contextlib.contextmanager
    def piece(self, name: str, total: int, first: str = "compiling") -> Iterator[Callable[[int], None]]:
        """One piece of `total` steps. Yields what to call with the number done; `first` is what comes before that."""
        if not self.console.is_terminal:
            self.console.print(f"{name}: {first}", markup=False)
        bar = self._bars.add_task(escape(f"{name}: {first}"), total=None)
        began: tuple[float, int] | None = None
        said = 0.0

        def report(done: int) -> None:
            nonlocal began, said
            self._bars.update(bar, description=escape(f"{name}: running"), total=total, completed=done)
            now = time.monotonic()
            if began is None:  # The time before it was the compiler's.
                began, said = (now, done), now
                if not self.console.is_terminal:
                    self.console.print(f"{name}: running", markup=False)
            elif not self.console.is_terminal and now - said > _SECONDS_BETWEEN_LINES:
                left = (now - began[0]) / (done - began[1]) * (total - done)
                self.console.print(f"{name}: {done} of {total}, about {left:.0f} s left", markup=False)
                said = now

        with self._bars:
            yield report
        self._bars.remove_task(bar)
