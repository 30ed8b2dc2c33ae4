"""What a killed process left of a file that it was writing, removed at the next write of that file.

The name of a temporary file or folder says which process made it: a digest of the machine, its
start and the namespace of its process numbers, then the number of the process and when it started.
Of the same machine since the same start it can be told for certain that this process has ended;
whatever is of another machine, an earlier start or another program is left alone. Where the system
says none of this (it is not Linux), names say nothing, and nothing is removed.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

__all__ = ["new_name", "sweep"]

#: Longest part of the name of a file in that of its temporary one.
_LONGEST = 40
_MARK = re.compile(r"([0-9a-f]{16})-([0-9a-f]+)-([0-9a-f]+)-[0-9a-f]{6}")
#: States of processes that have ended: zombie, dead.
_ENDED = ("Z", "X", "x")


def new_name(path: Path, prefix: str = ".", suffix: str = "") -> str:
    """Return a name that no file has, for what becomes a file.

    Parameters
    ----------
    path : Path
        The file that is to be written.
    prefix, suffix : str
        What the name starts with and ends with.

    Returns
    -------
    str
        Of this process, as far as the system says which it is.
    """
    token = secrets.token_hex(6)
    where = _where()
    if where is not None:
        number = os.getpid()
        token = f"{where}-{number:x}-{_state(number)[1]:x}-{token[:6]}"
    return f"{_stem(path, prefix)}{token}{suffix}"


def sweep(path: Path, prefix: str = ".", suffix: str = "") -> None:
    """Remove what processes that have ended left of a file.

    Parameters
    ----------
    path : Path
        The file that is to be written.
    prefix, suffix : str
        As of `new_name`.
    """
    start = _stem(path, prefix)
    where = _where()
    if where is None:
        return
    with suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            if not (entry.name.startswith(start) and entry.name.endswith(suffix)):
                continue
            mark = _MARK.fullmatch(entry.name[len(start) : len(entry.name) - len(suffix)])
            if (
                mark is None
                or mark[1] != where
                or not _has_ended(int(mark[2], 16), int(mark[3], 16))
            ):
                continue
            with suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                else:
                    Path(entry.path).unlink()


def _stem(path: Path, prefix: str) -> str:
    return f"{prefix}{path.stem[:_LONGEST]}-"


def _where() -> str | None:
    """Return a digest of machine, its start and process numbers; None where that is not known."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_bytes()
        space = Path("/proc/self/ns/pid").stat().st_ino
        # A process of another namespace sees other numbers, and itself by another one.
        if str(Path("/proc/self").readlink()) != str(os.getpid()):
            return None
        _state(os.getpid())
    except (OSError, ValueError, IndexError):
        return None
    said = b"\n".join([boot, str(space).encode(), socket.gethostname().encode()])
    return blake2b(said, digest_size=8).hexdigest()


def _state(number: int) -> tuple[str, int]:
    """Return the state of a process, and when it started, in ticks since the machine did.

    Raises
    ------
    OSError, ValueError, IndexError
        If that is not known.
    """
    fields = Path(f"/proc/{number}/stat").read_text(encoding="latin-1").rpartition(")")[2].split()
    return fields[0], int(fields[19])


def _has_ended(number: int, started: int) -> bool:
    """Return whether a process is known to have ended."""
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # a process of another user
        return False
    try:
        state, since = _state(number)
    except (OSError, ValueError, IndexError):
        return False
    return state in _ENDED or since != started
