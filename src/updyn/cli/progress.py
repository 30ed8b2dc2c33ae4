"""Live progress of a run on a terminal, plain lines elsewhere: a callback that can be told to stop the run."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.updating.monitor import Progress

__all__ = ["Watch", "watch"]

_STOPPING = "\nStopping after this step; the results so far will be written. Ctrl-C again to leave at once.\n"
_EVERY_S = 1.0  # plain lines of one stage, not closer than this


class Watch:
    """Shows each step and answers whether the user wants to stop.

    Parameters
    ----------
    console : rich.console.Console
        Where to write, usually stderr.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.stopping = False
        self._shown = "", 0.0  # stage and time of the last plain line
        self._live: Any = None
        self._task: Any = None

    def __call__(self, progress: Progress) -> bool:
        """Show one step; return whether to stop."""
        text = f"{progress.stage}  iteration {progress.iteration}  cost {progress.cost:.6g}"
        solved = f"{progress.lines_done} lines solved ({progress.n_lines} a step)"
        if self._live is not None:
            self._live.update(self._task, description=text, solved=solved)
        elif progress.stage != self._shown[0] or time.monotonic() - self._shown[1] >= _EVERY_S:
            self._shown = progress.stage, time.monotonic()
            self.console.print(f"{text}  {solved}", markup=False, highlight=False, soft_wrap=True)
        return self.stopping

    def interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        """Ask the run to end after its current step; a second time, end at once."""
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = True
        # Past the console: the signal may come while it writes, and it is not to be entered twice.
        with suppress(OSError, ValueError):  # a console that is no file has no one at Ctrl-C
            os.write(self.console.file.fileno(), _STOPPING.encode())

    @contextmanager
    def shown(self) -> Iterator[Watch]:
        """Draw a live line where the console is a terminal."""
        if not self.console.is_terminal:
            yield self
            return
        from rich.progress import Progress as Bar
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (SpinnerColumn(), TextColumn("{task.description}"), TextColumn("{task.fields[solved]}"))
        with Bar(*columns, TimeElapsedColumn(), console=self.console, transient=True) as self._live:
            self._task = self._live.add_task("starting", total=None, solved="")
            yield self
        self._live = None


@contextmanager
def watch(console: Console) -> Iterator[Watch]:
    """Give a `Watch` that Ctrl-C reaches: the first asks the run to end in order, the second ends it."""
    watching = Watch(console)
    if threading.current_thread() is not threading.main_thread():  # only the main thread is told of Ctrl-C
        with watching.shown():
            yield watching
        return
    before = signal.signal(signal.SIGINT, watching.interrupt)
    try:
        with watching.shown():
            yield watching
    finally:
        signal.signal(signal.SIGINT, before)
