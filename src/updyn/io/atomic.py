"""Files that are written whole or not at all."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from updyn.errors import FormatError
from updyn.io.leftovers import new_name, sweep

__all__ = ["atomic_path", "sync_folder", "write_bytes", "write_json"]


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it replaces `path` when the block ends well.

    Parameters
    ----------
    path : path
        The file to write.

    Yields
    ------
    Path
        Where to write: an empty file. It is removed when the block raises; `path` is then as it
        was. One that a killed process left is removed at the next write of the same file.

    Raises
    ------
    FormatError
        If the folder is not there or nothing can be written in it, `path` is a folder, or the disk
        is full.
    """
    path = Path(path)
    if "\0" in str(path):
        raise FormatError(f"{str(path)!r}: no file can have that name")
    if not path.parent.is_dir():
        raise FormatError(f"the folder {str(path.parent)!r} does not exist", path)
    if path.is_dir():
        raise FormatError("is a folder, not a file", path)
    sweep(path, suffix=path.suffix)
    temporary = path.with_name(new_name(path, suffix=path.suffix))
    try:
        # Not tempfile: its files are for their owner alone, and stay so once they have replaced a
        # shared one.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666))
        if path.exists():
            temporary.chmod(path.stat().st_mode & 0o777)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise FormatError(f"cannot be written: {error.strerror}", path) from error
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())  # else a crash may leave the new name with no content
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:  # a full disk, a quota, a limit on the size of files
        if error.filename not in (None, str(temporary), temporary):
            raise
        raise FormatError(f"cannot be written: {error.strerror or error}", path) from error
    finally:
        temporary.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on disk, where the system can say so.

    Parameters
    ----------
    folder : Path
        The folder; its files are synchronised one by one, by whoever writes them.
    """
    if sys.platform == "win32":  # no folder can be opened there
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # network file systems may refuse it for a folder
            os.fsync(number)
    finally:
        os.close(number)


def write_bytes(path: str | Path, *parts: bytes | memoryview) -> None:
    """Write bytes, the file replaced as a whole once it is complete.

    Parameters
    ----------
    path : path
        File to write.
    *parts : bytes-like
        The content, in order.

    Raises
    ------
    FormatError
        As of `atomic_path`.
    """
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(parts)


def write_json(content: Any, path: str | Path) -> None:
    """Write plain values as JSON, the file replaced as a whole once it is complete.

    Parameters
    ----------
    content : mapping
        Numbers, texts, lists and mappings; no number may be infinite or nan, which JSON does not
        have.
    path : path
        File to write.
    """
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
