"""Files written by a command: written completely, and never replaced without force."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from updyn.errors import FormatError, InputError
from updyn.io.leftovers import new_name, remove_leftovers

__all__ = ["check_free", "write_new"]

_UNFINISHED = ".unfinished-"


def write_new(target: Path, write: Callable[[Path], object], *, force: bool) -> None:
    """Write a file and its companion files; replace existing files only if forced."""
    if not target.parent.is_dir():
        raise FormatError(f"the folder {str(target.parent)!r} does not exist", target)
    # The names of companion files are known only after writing.
    with _staging_folder(target) as folder:
        staged = folder / target.name
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                write(staged)
            except FormatError as error:
                text = str(error).replace(str(staged), str(target))
                text = text.replace(str(staged.parent), str(target.parent))
                raise FormatError(text) from error
        for one in caught:
            text = str(one.message).replace(str(staged), str(target))
            warnings.warn(text, one.category, stacklevel=2)
        made = sorted(folder.iterdir())
        check_free([target.parent / path.name for path in made], force=force)
        for path in made:
            final = target.parent / path.name
            if final.exists():
                path.chmod(final.stat().st_mode & 0o777)
            path.replace(final)


@contextmanager
def _staging_folder(target: Path) -> Iterator[Path]:
    """Create a temporary folder next to a file, removed at the end; remove abandoned ones."""
    remove_leftovers(target, _UNFINISHED)
    folder = target.with_name(new_name(target, _UNFINISHED))
    try:
        folder.mkdir(0o700)
    except OSError as error:
        raise FormatError(f"cannot be written: {error.strerror}", target) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def check_free(files: Iterable[Path], *, force: bool) -> None:
    """Raise an error if a file exists, unless forced, or is a folder."""
    for path in files:
        if path.is_dir() or (not force and os.path.lexists(path)):
            what = "is a folder" if path.is_dir() else "exists already; --force writes over it"
            raise InputError(f"{path}: {what}")
