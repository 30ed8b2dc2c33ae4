"""The parent's side of the child process that reads files of other programs."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from updyn import errors
from updyn.errors import FormatError, InputError, damaged, reason_of
from updyn.foreign.child import OUT_OF_MEMORY, READY
from updyn.foreign.exits import describe_exit, signal_name
from updyn.foreign.limits import ReadLimits, limits_of
from updyn.foreign.plain import decode
from updyn.foreign.processes import start
from updyn.foreign.settings import READING
from updyn.registry import load_object

__all__ = ["UNSOUND", "load", "load_in_process"]

#: Exceptions of `decode` for a damaged answer.
UNSOUND = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def load(
    function: str,
    path: str | Path,
    *arguments: object,
    what: str,
    reader: str,
    extra_files: Iterable[str | Path] = (),
) -> Any:
    """Return plain data of files from ``"module:function"``, called in a child process."""
    others = list(map(str, extra_files))
    limits = limits_of(path, others)
    request = {
        "load": function,
        "path": str(path),
        "extra_files": others,
        "arguments": arguments,
    }
    found = _run_request(request, limits, f"cannot be read: its reader ({reader})")
    if "value" in found:
        return found["value"]
    if "error" in found:
        raise _error(found)
    raise damaged(path, what, found["failed"])


def load_in_process(function: str, path: str | Path, *arguments: object, what: str) -> object:
    """Load a file written by updyn in this process; the arguments are those of `load`."""
    loader = load_object(function)
    try:
        return loader(str(path), *arguments)
    except InputError:
        raise
    except Exception as error:  # whatever the library raises, as in the child process
        raise damaged(path, what, reason_of(error)) from error


def _run_request(
    request: Mapping[str, object], limits: ReadLimits, blame: str
) -> Mapping[str, Any]:
    """Return the answer of a child process after it has ended."""
    path = limits.path
    received = bytearray()
    is_ready = threading.Event()

    def receive(stream: BinaryIO) -> None:
        while len(received) <= limits.memory and (block := stream.read(READING.block_bytes)):
            received.extend(block)
            is_ready.set()
        is_ready.set()

    with start(request) as process:
        receiver = threading.Thread(target=receive, args=(process.stdout,), daemon=True)
        receiver.start()
        try:
            is_ready.wait(READING.start_seconds)
            receiver.join(limits.seconds)
            # Wait for the exit status, because a process with corrupt memory may still answer.
            status = process.wait(limits.seconds if not receiver.is_alive() else 0)
        except subprocess.TimeoutExpired as error:
            raise FormatError(f"{blame} ran over {limits.seconds:.0f} s", path) from error
        finally:
            process.kill()
            receiver.join()
    if status != 0:
        raise FormatError(f"{blame} crashed ({signal_name(status) or describe_exit(status)})", path)
    try:
        found: Mapping[str, Any] = decode(memoryview(received)[len(READY) :])
    except UNSOUND as error:
        raise FormatError(f"{blame} sent an unreadable answer ({error})", path) from error
    if found.get("failed") == OUT_OF_MEMORY:
        memory = limits.memory / 1e6
        raise FormatError(f"{blame} needed over {memory:,.0f} MB of memory", path)
    return found


def _error(found: Mapping[str, Any]) -> InputError:
    """Return the error raised by the function, with its place in the file."""
    kind = getattr(errors, str(found["error"]), None)
    if not (isinstance(kind, type) and issubclass(kind, InputError)):
        kind = InputError
    error: InputError = kind(str(found["text"]), key=found["key"])
    if isinstance(error, FormatError):
        error.path, error.line = found["path"], found["line"]
    return error
