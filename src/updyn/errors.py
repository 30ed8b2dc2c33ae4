"""The errors and warnings of updyn.

Everything raised because of what a user supplied derives from `UpdynError`::

    UpdynError
    ├── InputError            what was supplied cannot be used
    │   ├── DofError          a degree of freedom: unreadable, unknown, or named twice
    │   ├── ModelError        a matrix, a group or a model
    │   │   └── ToleranceError  no plant of a model holds the tolerance
    │   ├── DataError         a frequency response function or its selection
    │   ├── FormatError       a file: says path, and line or record where there is one
    │   │   └── AbsentError   the file does not hold what was asked for; it may hold something else
    │   ├── ParameterError    an unknown, its bounds or its group
    │   ├── OptionError       an option, a method or a keyword
    │   └── JobError          the job file: says file and line
    ├── SolverError           a line that cannot be solved: an undamped resonance, a singular model
    ├── StoppedError          the caller stopped work that has no result before its end
    └── EngineError           the processes or the cluster that do the work are lost

`UpdynWarning` marks what a user should know and may accept.

An `InputError` has a key path, ``error.key``: the names of arguments or keys, and positions in
arrays, of what it is about. The code that raises it states the path from its own arguments, such as
``key=("noise", "floor")``. A caller that took these from something larger puts their place there in
front, by `key_path`. The job adds its file and the line of the key once, by
`updyn.job.Job.located`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from os import PathLike

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
    """Base of every error that updyn raises on purpose.

    Examples
    --------
    >>> try:
    ...     updyn.Group([[1.0]], loss_factor=-0.1)
    ... except updyn.UpdynError as error:
    ...     print(type(error).__name__)
    ModelError
    """


class InputError(UpdynError, ValueError):
    """Something that was supplied cannot be used.

    Parameters
    ----------
    *args : object
        The message.
    key : sequence of str or int
        Path of what it is about, from what the raising code was given: names of arguments or keys,
        and positions in arrays.
    """

    def __init__(self, *args: object, key: Sequence[str | int] = ()) -> None:
        super().__init__(*args)
        self.key = tuple(key)


class DofError(InputError):
    """A degree of freedom is unreadable, unknown, or named twice."""


class ModelError(InputError):
    """A matrix, a group or a model is not valid."""


class ToleranceError(ModelError):
    """A model cannot be converted within the tolerance; the message says what was reached."""


class DataError(InputError):
    """A frequency response function, or a selection of it, is not valid."""


class ParameterError(InputError):
    """An unknown, its bounds or its group is not valid."""


class OptionError(InputError):
    """An option, a method name or a keyword is not valid."""


class _FileError(InputError):
    """An error at a place in a file; the message starts ``path:line:``."""

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
    """A file cannot be read: what was found, where, and what was expected."""


class AbsentError(FormatError):
    """A file does not hold what was asked for; it may hold something else."""


class JobError(_FileError):
    """The job file cannot be used: file, line, what was found, what was expected."""


class SolverError(UpdynError):
    """A line cannot be solved."""


class StoppedError(UpdynError):
    """The caller stopped work that has no result before its end."""


class EngineError(UpdynError):
    """The processes or the cluster that do the work are lost."""


class UpdynWarning(UserWarning):
    """Something that the user should know and may accept.

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
    """Put a key path in front of that of an `InputError` that is raised inside.

    Parameters
    ----------
    *key : str or int
        Where what is worked on inside comes from.
    otherwise : sequence of str or int
        The rest of the path where the error states none.

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
    """Return the choices that look most like a word, best first.

    Parameters
    ----------
    word : str
        What was found.
    choices : iterable of str
        What is valid.
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
    """Return the addition to a message that names the first of several; empty where it is all.

    Parameters
    ----------
    count : int
        How many there are.

    Returns
    -------
    str
    """
    if count < 2:
        return ""
    return f" ({count} such)"


def reason_of(error: BaseException) -> str:
    """Return what an error of a library says, in one line; its type where it says nothing.

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
    """Return the error that a file cannot be read by the library for its format.

    Parameters
    ----------
    path : path
        The file.
    what : str
        What it should be: ``"HDF5 file"``.
    why : str
        What the library says.

    Returns
    -------
    FormatError
    """
    return FormatError(
        f"not a readable {what}: the file is damaged, cut short, or another format ({why})", path
    )


def suggest(word: str, choices: Iterable[str]) -> str:
    """Return the end of an error message: the nearest valid choices, or all where none is near.

    Parameters
    ----------
    word : str
        What was found.
    choices : iterable of str
        What is valid.

    Returns
    -------
    str
    """
    options = list(dict.fromkeys(choices))
    close = nearest(word, options)
    if close:
        return f"did you mean {' or '.join(map(repr, close))}?"
    if not options:
        return "there is none to choose from"
    text = f"valid: {', '.join(map(repr, options[:12]))}"
    if len(options) > 12:
        text += f", ... ({len(options)} in all)"
    return text
