"""Where files that other files name may lie: anywhere, or in one folder.

A job names its inputs, a deck the files that it includes. A program that works on a project for
somebody else, as a server does, reads what lies in the project and nothing else.
"""

from __future__ import annotations

import errno
from pathlib import Path

from updyn.errors import InputError

__all__ = ["check_inside", "confine", "resolve_path"]

#: Error number of Windows for a chain of links that does not end.
_WINDOWS_LOOP = 1921
_folders: list[Path] = []


def confine(folder: Path) -> None:
    """Refuse from now on, in this process, every file that is named and lies outside a folder.

    Parameters
    ----------
    folder : Path
        The folder; it takes the place of an earlier one.
    """
    _folders[:] = [folder.resolve()]


def check_inside(path: Path) -> None:
    """Check that a file that another file names may be read.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        If this process is confined to a folder, and the file lies outside it or is not one.
    """
    for folder in _folders:
        if not resolve_path(path).is_relative_to(folder):
            raise InputError(
                f"{str(path)!r} lies outside the folder of the project ({folder}), where no file is"
                " read; copy it into the project, or serve a folder that holds both"
            )


def resolve_path(path: Path) -> Path:
    """Return the absolute path of a file without links.

    Unlike `Path.resolve`, which differs between versions of Python, this refuses links that lead
    to themselves.

    Parameters
    ----------
    path : Path
        The file; it need not exist.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the path cannot be that of a file: a link leads to itself, or the name holds characters
        that no name of a file can hold.
    """
    try:
        _check_loops(path)
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop before 3.13
        raise InputError(f"{str(path)!r} cannot be a file: {error}") from error


def _check_loops(path: Path) -> None:
    """Raise OSError if the links of a path do not end; other errors are left to the reader."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP or getattr(error, "winerror", None) == _WINDOWS_LOOP:
            raise
