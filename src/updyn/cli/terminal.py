"""What commands print: text, notes, errors and the progress of a run, which Ctrl-C stops in order; exit codes."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

from updyn.errors import UpdynWarning

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.updating.fit.monitor import Progress

__all__ = [
    "BAD_INPUT",
    "DONE",
    "NOT_DETERMINED",
    "STOPPED",
    "Watch",
    "complain",
    "note",
    "say",
    "stderr",
    "warnings_as_notes",
    "watch",
]

DONE, BAD_INPUT, NOT_DETERMINED, STOPPED = 0, 2, 3, 130

_STOPPING = (
    "\nStopping after these lines; the results so far will be written. Ctrl-C again to leave at"
    " once.\n"
)
_EVERY_S, _WITHIN_S = (
    1.0,
    10.0,
)  # plain lines of one stage, not closer than this: between steps, and within one


def stderr() -> Console:
    """Return a console that writes to stderr."""
    from rich.console import Console

    return Console(stderr=True)


def note(text: str, style: str | None = None) -> None:
    """Print a note to stderr."""
    stderr().print(text, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def complain(message: str) -> int:
    """Print an error to stderr and return the exit code of bad input."""
    note(f"error: {message}", "red")
    return BAD_INPUT


def say(text: str) -> None:
    """Print to stdout; a reader that has gone away (``updyn info FILE | head``) is not an error."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Show each `UpdynWarning` once, as a short note; leave other warnings as they are."""
    seen: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", UpdynWarning)
        others = warnings.showwarning

        def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if not issubclass(category, UpdynWarning):
                others(message, category, *where, **more)
            elif str(message) not in seen:
                seen.add(str(message))
                note(f"note: {message}", "yellow")

        warnings.showwarning = show
        yield


# -- progress -----
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
        self._shown = "", -1, 0.0  # stage, step and time of the last plain line
        self._live: Any = None
        self._task: Any = None

    def __call__(self, progress: Progress) -> bool:
        """Show a step, or how far the next one is; return whether to stop."""
        step = progress.iteration if progress.cost == progress.cost else -1  # nan: none so far
        text = (
            f"{progress.stage}  iteration {step}  cost {progress.cost:.6g}"
            if step >= 0
            else progress.stage
        )
        solved = (
            f"{progress.lines_done} lines solved ({progress.n_lines} a step)"
            if progress.n_lines
            else ""
        )
        if self._live is not None:
            self._live.update(self._task, description=text, solved=solved)
            return self.stopping
        stage, shown, when = self._shown
        pause = time.monotonic() - when
        first = progress.stage != stage or shown < 0 <= step
        if first or pause >= (_EVERY_S if step != shown else _WITHIN_S):
            self._shown = progress.stage, step, time.monotonic()
            self.console.print(
                f"{text}  {solved}".rstrip(),
                markup=False,
                emoji=False,
                highlight=False,
                soft_wrap=True,
            )
        return self.stopping

    def interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        """Ask the run to end after the lines under way; a second time, end at once."""
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

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            TextColumn("{task.fields[solved]}"),
        )
        with Bar(*columns, TimeElapsedColumn(), console=self.console, transient=True) as self._live:
            self._task = self._live.add_task("starting", total=None, solved="")
            yield self
        self._live = None


@contextmanager
def watch(console: Console) -> Iterator[Watch]:
    """Give a `Watch` that Ctrl-C reaches: the first asks the run to end in order, the second ends it."""
    watching = Watch(console)
    if (
        threading.current_thread() is not threading.main_thread()
    ):  # only the main thread is told of Ctrl-C
        with watching.shown():
            yield watching
        return
    before = signal.signal(signal.SIGINT, watching.interrupt)
    try:
        with watching.shown():
            yield watching
    finally:
        signal.signal(signal.SIGINT, before)
