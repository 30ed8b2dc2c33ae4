"""Folder lock for a single writer, released by the system when its process ends."""

from __future__ import annotations

import errno
import os
import socket
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from updyn.errors import FormatError, InputError, UpdynWarning

__all__ = ["LOCK", "InUseError", "lock_folder", "release_all"]

#: Name of the locked file. The system drops a lock when its process ends. The file names the owner;
#: a file left by a killed process is not locked.
LOCK = ".updyn.lock"
_START = "updyn process "
#: Error codes of a lock held by another process.
_BUSY_ERRORS = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
#: Lock files of this process, removed if it ends without unwinding.
_lock_files: set[Path] = set()


class InUseError(InputError):
    """Another process is writing to the folder."""


if sys.platform == "win32":
    import msvcrt

    def _lock(number: int) -> None:
        """Lock an open file, or raise OSError at once."""
        os.lseek(number, 1 << 30, os.SEEK_SET)  # keep the text at the start readable
        msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
        os.lseek(number, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(number: int) -> None:
        """Lock an open file, or raise OSError at once."""
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock an existing folder against writing by other processes and threads.

    An `InUseError` with the process is raised if it is locked, a `FormatError` if the lock file
    cannot be written or belongs to a user. An `UpdynWarning` is given if the file system does not
    support locks.
    """
    path = folder / LOCK
    number = _acquire_lock(path)
    _lock_files.add(path)
    try:
        yield
    finally:
        _lock_files.discard(path)
        if sys.platform == "win32":  # Windows cannot remove an open file
            os.close(number)
            with suppress(OSError):
                path.unlink()
        else:
            with suppress(OSError):
                path.unlink()
            os.close(number)


def release_all() -> None:
    """Remove the lock files of this process before it ends without unwinding."""
    for path in tuple(_lock_files):
        with suppress(OSError):
            path.unlink()


def _acquire_lock(path: Path) -> int:
    """Return the file descriptor of the locked file."""
    while True:
        with ExitStack() as cleanup:
            number = _open_lock_file(path)
            cleanup.callback(os.close, number)
            _write_owner(number, path)
            if _is_same_file(number, path):
                cleanup.pop_all()
                return number
            # else the owner has just removed the file: try again


def _open_lock_file(path: Path) -> int:
    """Open the lock file, creating it if missing; raise an error for a user's file."""
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise FormatError(f"cannot be written: {error.strerror}", path) from error
    text = _read_text(number)
    if text and not text.startswith(_START):
        os.close(number)
        raise FormatError("is not the lock of a folder that updyn wrote; move it", path)
    return number


def _write_owner(number: int, path: Path) -> None:
    try:
        _lock(number)
    except OSError as error:
        if error.errno in _BUSY_ERRORS:
            owner = _read_text(number).strip() or "another process"
            raise InUseError(
                f"{str(path.parent)!r} is being written to by {owner}; wait until it has ended, or"
                " choose another folder"
            ) from error
        warnings.warn(
            f"{path.parent}: cannot be locked ({error.strerror}); two runs that write there at the"
            " same time would not notice each other",
            UpdynWarning,
            stacklevel=4,
        )
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    os.ftruncate(number, 0)
    os.lseek(number, 0, os.SEEK_SET)
    os.write(number, f"{_START}{os.getpid()} on {socket.gethostname()}, since {since}\n".encode())


def _read_text(number: int) -> str:
    """Return the start of an open file as text."""
    os.lseek(number, 0, os.SEEK_SET)
    return os.read(number, 256).decode("utf-8", "replace")


def _is_same_file(number: int, path: Path) -> bool:
    """Return whether the path still refers to the open file."""
    try:
        return os.path.samestat(os.fstat(number), path.stat())
    except FileNotFoundError:
        return False
