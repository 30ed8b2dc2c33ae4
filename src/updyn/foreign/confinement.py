"""Where files that other files name may lie: anywhere, or in one folder.

A job names its inputs, a deck the files that it includes. A program that works on a project for
somebody else, as a server does, reads what lies in the project and nothing else.
"""

from __future__ import annotations

from pathlib import Path

from updyn.errors import InputError

__all__ = ["check_inside", "confine"]

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
        try:
            place = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a link to itself; no text at all
            raise InputError(f"{str(path)!r} cannot be a file: {error}") from error
        if not place.is_relative_to(folder):
            raise InputError(
                f"{str(path)!r} lies outside the folder of the project ({folder}), where no file is"
                " read; copy it into the project, or serve a folder that holds both"
            )
