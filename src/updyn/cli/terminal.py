"""Exit codes, and output of the commands: text, notes and errors."""

from __future__ import annotations

import io
import os
import sys
import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from updyn.cli.highlight import THEME, SummaryHighlighter
from updyn.errors import UpdynWarning
from updyn.text_table import printable

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "BAD_INPUT",
    "DONE",
    "NOT_DETERMINED",
    "STOPPED",
    "TERMINATED",
    "encode_anything",
    "print_error",
    "print_note",
    "print_text",
    "printable",
    "stderr",
    "warnings_as_notes",
    "wrap_text",
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
        chosen.print(shown, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def print_error(message: str) -> int:
    """Print an error to stderr and return the exit code of bad input."""
    print_note(f"error: {message}", "red")
    return BAD_INPUT


def print_text(text: str) -> None:
    """Print to stdout, in colour on a terminal; a closed pipe (``| head``) is not an error."""
    if sys.stdout is None:  # closed before the start of the process
        return
    with _ignore_closed_pipe(sys.stdout):
        if sys.stdout.isatty():
            _print_coloured(printable(text))
        else:
            sys.stdout.write(printable(text) + "\n")
            sys.stdout.flush()


@contextmanager
def _ignore_closed_pipe(stream: TextIO | None) -> Iterator[None]:
    """Discard further output after the reader of a stream has closed it."""
    try:
        yield
    except BrokenPipeError:
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _print_coloured(text: str) -> None:
    """Print to the terminal, in colour if it and the user (``NO_COLOR``) allow it."""
    from rich.console import Console

    console = Console(theme=THEME, highlighter=SummaryHighlighter())
    shown = wrap_text(text, console.width)
    console.print(shown, markup=False, emoji=False, highlight=True, soft_wrap=True)


def wrap_text(text: str, width: int) -> str:
    """Return text wrapped to a width, except table rows (two blanks between their columns)."""
    lines = []
    for line in text.splitlines():
        indent = line[: len(line) - len(line.lstrip())]
        if len(line) <= width or "  " in line.strip():
            lines.append(line)
            continue
        whole = textwrap.TextWrapper(
            width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        lines += whole.wrap(line)
    return "\n".join(lines)


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
