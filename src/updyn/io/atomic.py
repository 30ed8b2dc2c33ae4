"""Atomic writing: a file is written completely or not at all."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from updyn.errors import FormatError
from updyn.io.leftovers import new_name, remove_leftovers

__all__ = ["atomic_path", "sync_folder", "write_bytes", "write_json"]


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that replaces `path` after a successful block.

    The file is empty at first. If the block raises, it is removed and `path` remains unchanged; a
    temporary file of a killed process is removed at the next write of the same file. A missing
    folder or a full disk raises a `FormatError`.
    """
    path = Path(path)
    if "\0" in str(path):
        raise FormatError(f"{str(path)!r} is not a valid file name")
    if not path.parent.is_dir():
        raise FormatError(f"the folder {str(path.parent)!r} does not exist", path)
    if path.is_dir():
        raise FormatError("is a folder, not a file", path)
    remove_leftovers(path, suffix=path.suffix)
    temporary = path.with_name(new_name(path, suffix=path.suffix))
    try:
        # Not tempfile: its files are readable only by their owner, even after they have replaced a
        # shared file.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666))
        if path.exists():
            temporary.chmod(path.stat().st_mode & 0o777)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise FormatError(f"cannot be written: {error.strerror}", path) from error
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())  # otherwise a crash may leave an empty file
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:  # a full disk, a quota, a limit on file size
        if error.filename not in (None, str(temporary), temporary):
            raise
        raise FormatError(f"cannot be written: {error.strerror or error}", path) from error
    finally:
        temporary.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Wait until the file names of a folder are on disk, if the system supports it."""
    if sys.platform == "win32":  # Windows cannot open folders
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # network file systems may refuse it for folders
            os.fsync(number)
    finally:
        os.close(number)


def write_bytes(path: str | Path, *parts: bytes | memoryview) -> None:
    """Write bytes to a file; an existing file is replaced only once the new one is complete."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(parts)


def write_json(content: object, path: str | Path) -> None:
    """Write plain values as JSON, atomically; infinities and NaN, which JSON lacks, are refused."""
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
