"""Tracebacks of errors of the input in IPython and notebooks: they end at the caller's line.

An `InputError` is about the arguments of a call, and its message names them; the frames inside
updyn do not help to correct it. Python's development mode (``python -X dev``) shows all frames, and
so do debuggers and plain Python, whose hooks stay as they are. Other errors are not affected.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

__all__ = ["cut_traceback", "render_error"]

_PACKAGE = __name__.partition(".")[0]


def cut_traceback(found: TracebackType | None) -> TracebackType | None:
    """Return a traceback without the last frames, those inside updyn; unchanged if all are."""
    frames = []
    while found is not None:
        frames.append(found)
        found = found.tb_next
    kept = len(frames)
    while kept and _is_internal(frames[kept - 1]):
        kept -= 1
    cut: TracebackType | None = None
    for one in reversed(frames[: kept or len(frames)]):
        cut = TracebackType(cut, one.tb_frame, one.tb_lasti, one.tb_lineno)
    return cut


def _is_internal(found: TracebackType) -> bool:
    name = str(found.tb_frame.f_globals.get("__name__", ""))
    return name == _PACKAGE or name.startswith(f"{_PACKAGE}.")


@contextmanager
def _cut(error: BaseException) -> Iterator[BaseException]:
    """Give an error the traceback that is shown, without its causes, inside the context."""
    kept = error.__traceback__, error.__cause__, error.__suppress_context__
    if not sys.flags.dev_mode:
        error.__traceback__ = cut_traceback(error.__traceback__)
        error.__cause__ = None  # the message holds the reason
        error.__suppress_context__ = True
    try:
        yield error
    finally:
        error.__traceback__, error.__cause__, error.__suppress_context__ = kept


def render_error(error: BaseException) -> list[str]:
    """Return the lines that IPython shows of an error, with the frames of the caller."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    with _cut(error):
        if shell is None:
            return traceback.format_exception(error)
        lines: list[str] = shell.InteractiveTB.structured_traceback(
            type(error), error, error.__traceback__
        )
        return lines
