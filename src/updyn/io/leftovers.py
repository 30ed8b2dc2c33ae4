"""Temporary files of killed processes, removed at the next write of the same file.

The name of a temporary file identifies its process: a digest of the machine, its boot and the
namespace of process numbers, then the number of the process and its start time. Files of another
machine, boot or program are kept. Systems other than Linux lack this information, and nothing is
removed.
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

from updyn.io.settings import FILE_TEXT

__all__ = ["new_name", "remove_leftovers"]

_MARK = re.compile(r"([0-9a-f]{16})-([0-9a-f]+)-([0-9a-f]+)-[0-9a-f]{6}")
#: States of processes that have ended: zombie, dead.
_ENDED_STATES = ("Z", "X", "x")


def new_name(path: Path, prefix: str = ".", suffix: str = "") -> str:
    """Return an unused name for a temporary file that becomes `path`, with the process if known."""
    token = secrets.token_hex(6)
    where = _machine_digest()
    if where is not None:
        number = os.getpid()
        token = f"{where}-{number:x}-{_process_state(number)[1]:x}-{token[:6]}"
    return f"{_stem(path, prefix)}{token}{suffix}"


def remove_leftovers(path: Path, prefix: str = ".", suffix: str = "") -> None:
    """Remove temporary files of `path` whose processes have ended."""
    start = _stem(path, prefix)
    where = _machine_digest()
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
    return f"{prefix}{path.stem[: FILE_TEXT.temporary_stem]}-"


def _machine_digest() -> str | None:
    """Return a digest of machine, boot and process namespace, or None if unknown."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_bytes()
        space = Path("/proc/self/ns/pid").stat().st_ino
        # Process numbers differ between namespaces.
        if str(Path("/proc/self").readlink()) != str(os.getpid()):
            return None
        _process_state(os.getpid())
    except (OSError, ValueError, IndexError):
        return None
    identity = b"\n".join([boot, str(space).encode(), socket.gethostname().encode()])
    return blake2b(identity, digest_size=8).hexdigest()


def _process_state(number: int) -> tuple[str, int]:
    """Return the state of a process, and its start in ticks since the boot of the machine."""
    fields = Path(f"/proc/{number}/stat").read_text(encoding="latin-1").rpartition(")")[2].split()
    return fields[0], int(fields[19])


def _has_ended(number: int, started: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # a process of another user
        return False
    try:
        state, since = _process_state(number)
    except (OSError, ValueError, IndexError):
        return False
    return state in _ENDED_STATES or since != started
