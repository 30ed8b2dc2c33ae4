"""Exit codes, and output of the commands: text, notes and errors."""

from __future__ import annotations

import io
import os
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from updyn.cli.highlight import STYLES, highlight
from updyn.cli.layout import fit_text
from updyn.cli.settings import LAYOUT
from updyn.errors import UpdynWarning
from updyn.text_table import printable

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.updating.judge.badge import Badge

__all__ = [
    "BAD_INPUT",
    "DONE",
    "NOT_DETERMINED",
    "STOPPED",
    "TERMINATED",
    "encode_anything",
    "output_width",
    "print_error",
    "print_note",
    "print_outcome",
    "print_text",
    "printable",
    "stderr",
    "warnings_as_notes",
]

#: Exit codes.
DONE = 0
BAD_INPUT = 2
NOT_DETERMINED = 3
STOPPED = 130
TERMINATED = 143  # stopped by SIGTERM


def encode_anything() -> None:
    """Make stdout and stderr escape characters that their encoding does not support."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def stderr() -> Console:
    """Return a console that writes to stderr, or nowhere if it is closed."""
    from rich.console import Console

    return Console(stderr=True) if sys.stderr is not None else Console(file=io.StringIO())


def print_note(text: str, style: str | None = None, console: Console | None = None) -> None:
    """Print a note to stderr, or to a console that writes there."""
    chosen, shown = console or stderr(), printable(text)
    with _ignore_closed_pipe(sys.stderr):
        if not chosen.is_terminal:
            chosen.file.write(shown + "\n")
            chosen.file.flush()
            return
        shown = fit_text(shown, max(chosen.width, LAYOUT.least_width))
        chosen.print(shown, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def print_error(message: str) -> int:
    """Print an error to stderr and return the exit code of bad input."""
    print_note(f"error: {message}", "red")
    return BAD_INPUT


def output_width() -> int | None:
    """Return the width of stdout: COLUMNS, or that of the terminal; None (unlimited) for a pipe."""
    stated = os.environ.get("COLUMNS", "")
    if stated.isdecimal() and int(stated):
        return max(int(stated), LAYOUT.least_width)
    if sys.stdout is None or not sys.stdout.isatty():
        return None
    return max(shutil.get_terminal_size().columns, LAYOUT.least_width)


def print_text(text: str, badge: Badge | None = None) -> None:
    """Print to stdout, in colour on a terminal, with the verdict of `badge` in its colour.

    Text is laid out for the width of the output. A closed pipe (``| head``) is not an error.
    """
    if sys.stdout is None:  # closed before the start of the process
        return
    shown, width = printable(text), output_width()
    if width is not None:
        shown = fit_text(shown, width)
    with _ignore_closed_pipe(sys.stdout):
        if sys.stdout.isatty():
            _print_coloured(shown, badge)
        else:
            sys.stdout.write(shown + "\n")
            sys.stdout.flush()


def print_outcome(details: str, outcome: str, *, verbose: bool, badge: Badge | None = None) -> None:
    """Print the outcome of a command, after its details if they were asked for."""
    if verbose and details:
        print_text(f"{details}\n", badge)
    print_text(outcome, badge)


@contextmanager
def _ignore_closed_pipe(stream: TextIO | None) -> Iterator[None]:
    """Discard further output after the reader of a stream has closed it."""
    try:
        yield
    except BrokenPipeError:
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _print_coloured(text: str, badge: Badge | None) -> None:
    """Print to the terminal, in colour if it and the user (``NO_COLOR``) allow it."""
    from rich.console import Console
    from rich.theme import Theme

    console = Console(theme=Theme(STYLES))
    console.print(highlight(text, badge), soft_wrap=True)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Show each `UpdynWarning` once, as a short note; leave other warnings as they are."""
    printed: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", UpdynWarning)
        others = warnings.showwarning

        def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if not issubclass(category, UpdynWarning):
                others(message, category, *where, **more)
            elif str(message) not in printed:
                printed.add(str(message))
                print_note(f"note: {message}", "yellow")

        warnings.showwarning = show
        yield
