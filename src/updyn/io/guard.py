"""Turning what goes wrong inside a file into a `FormatError` that names the file.

The libraries that read archives raise a zoo of exceptions for a damaged file. They are caught at
the call into the library and nowhere else, so that a mistake of our own is not taken for a bad
file.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from updyn.dofs import Dof, DofSet
from updyn.errors import FormatError, InputError, suggest

__all__ = ["FAILURES", "chosen", "known_only", "library", "placed"]

#: What h5py, numpy, scipy.io and zipfile raise for damaged files (found by flipping bytes in good
#: ones).
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def library(path: str | Path, what: str) -> Iterator[None]:
    """Report any failure of a library that reads `path` as a `FormatError`; `what` is what the file should be."""
    try:
        yield
    except InputError:
        raise
    except FAILURES as error:
        text = str(error).strip().splitlines()
        reason = text[0] if text else type(error).__name__
        raise FormatError(
            f"not a readable {what}: the file is damaged, cut short, or another format ({reason})",
            path,
        ) from error


@contextmanager
def placed(path: str | Path, item: str = "") -> Iterator[None]:
    """Give an error about what a file holds the path, and the item, that it belongs to."""
    try:
        yield
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(f"{item}: {error}" if item else str(error), path) from error


def chosen(labels: Iterable[str | Dof], side: str, path: str | Path) -> DofSet:
    """Return the DOFs to select of a side, "responses" or "references", at least one.

    Raises
    ------
    FormatError
        If there is none, one cannot be read or stands twice.
    """
    with placed(path, side):
        dofs = DofSet(labels)
    if not len(dofs):
        raise FormatError(f"{side}: an empty list; leave it out to read all", path)
    return dofs


def known_only(
    found: Collection[str], known: Collection[str], path: str | Path, where: str = ""
) -> None:
    """Refuse names that mean nothing here: a misspelt one would be left out without a word.

    Raises
    ------
    FormatError
        If a name of `found` is not in `known`; the nearest known ones are given.
    """
    for name in found:
        if name not in known:
            raise FormatError(
                f"{where + ': ' if where else ''}unknown name {name!r}; {suggest(name, known)}",
                path,
            )
