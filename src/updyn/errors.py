"""The errors and warnings of updyn.

Errors caused by user input derive from `UpdynError`::

    UpdynError
    ├── InputError            an input cannot be used
    │   ├── DofError          a degree of freedom: unreadable, unknown, or named twice
    │   ├── ModelError        a matrix, a group or a model
    │   │   └── ToleranceError  no plant of a model meets the tolerance
    │   ├── DataError         a frequency response function or its selection
    │   ├── FormatError       a file: gives path and, if known, line or record
    │   │   └── AbsentError   the file lacks the requested data; it may hold other data
    │   ├── ParameterError    an unknown, its bounds or its group
    │   ├── OptionError       an option, a method or a keyword
    │   └── JobError          the job file: gives file and line
    ├── SolverError           a line without a solution: undamped resonance, singular model
    ├── StoppedError          the caller stopped work that has no partial result
    └── EngineError           worker processes or the cluster were lost

`UpdynWarning` marks information that the user should know and may accept.

An `InputError` has a key path, ``error.key``: names of arguments or keys, and positions in arrays,
that identify the input. The code that raises it gives the path within its own arguments, such as
``key=("noise", "floor")``. A caller that extracted these arguments from a larger input prepends
their place with `key_path`. `updyn.job.Job.located` adds the job file and the line of the key.

In IPython and notebooks, the traceback of an `InputError` ends at the caller's line; ``python -X
dev`` shows all of its frames.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from os import PathLike

from updyn.tracebacks import render_error

__all__ = [
    "AbsentError",
    "DataError",
    "DofError",
    "EngineError",
    "FormatError",
    "InputError",
    "JobError",
    "ModelError",
    "OptionError",
    "ParameterError",
    "SolverError",
    "StoppedError",
    "ToleranceError",
    "UpdynError",
    "UpdynWarning",
    "damaged",
    "in_all",
    "key_path",
    "nearest",
    "reason_of",
    "suggest",
]


class UpdynError(Exception):
    """Base class of the errors of updyn.

    Examples
    --------
    >>> try:
    ...     updyn.Group([[1.0]], loss_factor=-0.1)
    ... except updyn.UpdynError as error:
    ...     print(type(error).__name__)
    ModelError
    """


class InputError(UpdynError, ValueError):
    """An input cannot be used.

    Parameters
    ----------
    *args : object
        The message.
    key : sequence of str or int
        Path of the input within the arguments of the raising code: names of arguments or keys, and
        positions in arrays.
    """

    def __init__(self, *args: object, key: Sequence[str | int] = ()) -> None:
        super().__init__(*args)
        self.key = tuple(key)

    def _render_traceback_(self) -> list[str]:  # IPython calls it
        return render_error(self)


class DofError(InputError):
    """A degree of freedom is unreadable, unknown, or named twice."""


class ModelError(InputError):
    """A matrix, a group or a model is not valid."""


class ToleranceError(ModelError):
    """A model cannot be converted within the tolerance; the message gives the error reached."""


class DataError(InputError):
    """A frequency response function, or a selection of it, is not valid."""


class ParameterError(InputError):
    """An unknown, its bounds or its group is not valid."""


class OptionError(InputError):
    """An option, a method name or a keyword is not valid."""


class _FileError(InputError):
    """An error at a place in a file; the message starts with ``path:line:``."""

    def __init__(
        self,
        message: str,
        path: str | PathLike[str] | None = None,
        line: int | None = None,
        *,
        key: Sequence[str | int] = (),
    ) -> None:
        self.path = None if path is None else str(path)
        self.line = line
        if path is not None:
            place = f"{path}:" if line is None else f"{path}:{line}:"
            message = f"{place} {message}"
        super().__init__(message, key=key)


class FormatError(_FileError):
    """A file cannot be read; the message gives the place, the finding and the expectation."""


class AbsentError(FormatError):
    """A file lacks the requested data; it may hold other data."""


class JobError(_FileError):
    """The job file cannot be used; the message gives file, line, finding and expectation."""


class SolverError(UpdynError):
    """The equations cannot be solved at a frequency line."""


class StoppedError(UpdynError):
    """The caller stopped work that has no partial result."""


class EngineError(UpdynError):
    """The worker processes or the cluster were lost."""


class UpdynWarning(UserWarning):
    """Warning about something that the user should know and may accept.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", updyn.UpdynWarning)  # an error instead
    ...     updyn.Group([[1.0]], loss_factor=0.02).loss_factor
    0.02
    """


@contextmanager
def key_path(*key: str | int, otherwise: Sequence[str | int] = ()) -> Iterator[None]:
    """Prepend a key path to that of an `InputError` raised in the context.

    Parameters
    ----------
    *key : str or int
        Place of the input that is processed in the context.
    otherwise : sequence of str or int
        Rest of the path if the error has no key.

    Yields
    ------
    None
    """
    try:
        yield
    except InputError as error:
        error.key = (*key, *(error.key or otherwise))
        raise


def nearest(word: str, choices: Iterable[str], n: int = 3) -> list[str]:
    """Return the choices most similar to a word, best first.

    Parameters
    ----------
    word : str
        The word found.
    choices : iterable of str
        The valid words.
    n : int
        Largest number to return.

    Returns
    -------
    list of str
    """
    options: Sequence[str] = list(dict.fromkeys(choices))
    exact = [c for c in options if c.casefold() == word.casefold()]
    close = difflib.get_close_matches(word, options, n=n, cutoff=0.6)
    return list(dict.fromkeys(exact + close))[:n]


def in_all(count: int) -> str:
    """Return the count for a message that names the first of several; empty for only one.

    Parameters
    ----------
    count : int
        Total number.

    Returns
    -------
    str
    """
    if count < 2:
        return ""
    return f" ({count} such)"


def reason_of(error: BaseException) -> str:
    """Return the message of a library's error in one line; its type if the message is empty.

    Parameters
    ----------
    error : BaseException
        The error.

    Returns
    -------
    str
    """
    for line in str(error).splitlines():
        if line.strip():
            return line.strip()
    return type(error).__name__


def damaged(path: str | PathLike[str], what: str, why: str) -> FormatError:
    """Return the error for a file that the library of its format cannot read.

    Parameters
    ----------
    path : path
        The file.
    what : str
        The expected kind, such as ``"HDF5 file"``.
    why : str
        The message of the library.

    Returns
    -------
    FormatError
    """
    return FormatError(
        f"not a readable {what}: the file is damaged, cut short, or another format ({why})", path
    )


def suggest(word: str, choices: Iterable[str]) -> str:
    """Return the end of an error message: the nearest valid choices, or all if none is near.

    Parameters
    ----------
    word : str
        The word found.
    choices : iterable of str
        The valid words.

    Returns
    -------
    str
    """
    options = list(dict.fromkeys(choices))
    close = nearest(word, options)
    if close:
        return f"did you mean {' or '.join(map(repr, close))}?"
    if not options:
        return "no choices exist"
    text = f"valid: {', '.join(map(repr, options[:12]))}"
    if len(options) > 12:
        text += f", ... ({len(options)} in all)"
    return text
