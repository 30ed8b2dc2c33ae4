"""What the child process does: take limits on, load one file, send the answer."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from updyn.errors import InputError, reason_of
from updyn.foreign.limits import Limits, limits_of
from updyn.foreign.plain import encode
from updyn.registry import load_object

__all__ = ["OUT_OF_MEMORY", "READY", "answer"]

#: What the child sends first, once all that the reading needs is imported.
READY = b"."
OUT_OF_MEMORY = "MemoryError"


def answer(request: Mapping[str, Any]) -> None:
    """Load a file and write the answer to where standard output went.

    Parameters
    ----------
    request : mapping
        ``load``, a text ``"module:function"``; ``path``; ``beside``, files that are read with it;
        ``arguments``, more arguments of the function.
    """
    path = request["path"]
    with os.fdopen(os.dup(1), "wb") as out:
        _silence()
        found = _attempt(lambda: load_object(request["load"]))
        out.write(READY)
        out.flush()
        if "value" in found:
            load = found["value"]
            _limit(limits_of(path, request["beside"]))
            found = _attempt(lambda: load(path, *request["arguments"]))
        for part in encode(found):
            out.write(part)


def _silence() -> None:
    """Drop what readers print, in Python or in C."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def _attempt(act: Callable[[], Any]) -> dict[str, Any]:
    """Return what a function gives as ``value``, else the error of ours, or why it failed."""
    try:
        return {"value": act()}
    except InputError as error:
        place = {name: getattr(error, name, None) for name in ("path", "line")}
        return {"error": type(error).__name__, "text": str(error), "key": error.key, **place}
    except MemoryError:
        return {"failed": OUT_OF_MEMORY}
    # Whatever the library raises for a damaged file; some end the process.
    except (Exception, SystemExit) as error:  # noqa: BLE001
        return {"failed": reason_of(error)}


def _limit(limits: Limits) -> None:
    """Let the system enforce the limits, where it can."""
    try:
        import resource
    except ImportError:  # Windows: the parent process keeps the time
        return
    # For an orphan, whose parent process was killed while it kept the time.
    seconds = int(limits.seconds + sum(os.times()[:2])) + 2
    memory = _taken() + limits.memory
    for what, most in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CORE, 0),
    ):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(what, (most, most))


def _taken() -> int:
    """Return the bytes of address space that the program itself takes."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 10**9
