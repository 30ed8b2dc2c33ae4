"""Exit codes, and output of the commands: text, notes, errors and the progress of a run."""

from __future__ import annotations

import math
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
    "ProgressDisplay",
    "print_error",
    "print_note",
    "print_text",
    "show_progress",
    "stderr",
    "warnings_as_notes",
]

#: Exit codes.
DONE = 0
BAD_INPUT = 2
NOT_DETERMINED = 3
STOPPED = 130

_STOPPING = (
    "\nStopping after these lines; the results so far will be written. Ctrl-C again to leave at"
    " once.\n"
)
#: Shortest time between plain lines of a stage, in s: between steps, and within one.
_BETWEEN_STEPS = 1.0
_WITHIN_STEP = 10.0


def stderr() -> Console:
    """Return a console that writes to stderr."""
    from rich.console import Console

    return Console(stderr=True)


def print_note(text: str, style: str | None = None) -> None:
    """Print a note to stderr."""
    stderr().print(text, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def print_error(message: str) -> int:
    """Print an error to stderr and return the exit code of bad input."""
    print_note(f"error: {message}", "red")
    return BAD_INPUT


def print_text(text: str) -> None:
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
                print_note(f"note: {message}", "yellow")

        warnings.showwarning = show
        yield


# -- progress --------------------------------------------------------------------------------------
class ProgressDisplay:
    """Shows the progress of a run: a live line on a terminal, plain lines elsewhere.

    Parameters
    ----------
    console : rich.console.Console
        Where to write, usually stderr.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.stopping = False
        # Stage, step and time of the last plain line.
        self._shown = "", -1, 0.0
        self._live: Any = None
        self._task: Any = None

    def __call__(self, progress: Progress) -> bool:
        """Show a step, or the lines solved for the next one; return whether to stop."""
        step = -1 if math.isnan(progress.cost) else progress.iteration
        text = progress.stage
        if step >= 0:
            text += f"  iteration {progress.made}  cost {progress.cost:.6g}"
        solved = ""
        if progress.n_lines:
            solved = f"{progress.lines_done} lines solved ({progress.n_lines} a step)"
        if self._live is not None:
            self._live.update(self._task, description=text, solved=solved)
        elif self._is_due(progress.stage, step):
            self._shown = progress.stage, step, time.monotonic()
            line = f"{text}  {solved}".rstrip()
            self.console.print(line, markup=False, emoji=False, highlight=False, soft_wrap=True)
        return self.stopping

    def _is_due(self, stage: str, step: int) -> bool:
        """Return whether a plain line is printed: the first of a stage, or after a pause."""
        shown_stage, shown_step, shown_at = self._shown
        if stage != shown_stage or shown_step < 0 <= step:
            return True
        pause = _WITHIN_STEP if step == shown_step else _BETWEEN_STEPS
        return time.monotonic() - shown_at >= pause

    def interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        """Ask the run to end after the lines under way; a second time, end at once."""
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = True
        # Written past the console, which the signal may have interrupted while it wrote. A console
        # that is no file is not used interactively.
        with suppress(OSError, ValueError):
            os.write(self.console.file.fileno(), _STOPPING.encode())

    @contextmanager
    def shown(self) -> Iterator[ProgressDisplay]:
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
def show_progress(console: Console) -> Iterator[ProgressDisplay]:
    """Return a display as a context: Ctrl-C asks the run to stop, a second one ends it."""
    display = ProgressDisplay(console)
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread may handle signals.
        with display.shown():
            yield display
        return
    before = signal.signal(signal.SIGINT, display.interrupt)
    try:
        with display.shown():
            yield display
    finally:
        signal.signal(signal.SIGINT, before)
