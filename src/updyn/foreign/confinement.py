"""Allowed places of files that other files refer to: anywhere, or in one folder.

A program that works on a project for another user, such as a server, may read only its files.
"""

from __future__ import annotations

import errno
from pathlib import Path

from updyn.errors import InputError

__all__ = ["check_inside", "confine", "resolve_path"]

#: Error number of Windows for an endless chain of links.
_WINDOWS_LOOP = 1921
_folders: list[Path] = []


def confine(folder: Path) -> None:
    """Refuse all files outside a folder, which replaces an earlier one, in this process."""
    _folders[:] = [folder.resolve()]


def check_inside(path: Path) -> None:
    """Refuse a file that another file refers to if it is outside the folder of this process."""
    for folder in _folders:
        if not resolve_path(path).is_relative_to(folder):
            raise InputError(
                f"{str(path)!r} is outside the folder of the project ({folder}), and is not read;"
                " copy it into the project, or serve a folder that contains both"
            )


def resolve_path(path: Path) -> Path:
    """Return the absolute path of a file without links; the file need not exist."""
    # Unlike `Path.resolve`, which differs between versions of Python, this refuses circular links.
    try:
        _check_loops(path)
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop before 3.13
        raise InputError(f"{str(path)!r} cannot be a file: {error}") from error


def _check_loops(path: Path) -> None:
    """Raise OSError for circular links; the reader reports other errors."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP or getattr(error, "winerror", None) == _WINDOWS_LOOP:
            raise
