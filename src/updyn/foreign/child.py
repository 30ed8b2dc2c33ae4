"""The child processes: set limits, load one file, send the answer; or fork processes for this."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import socket
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from updyn.errors import InputError, reason_of
from updyn.foreign.limits import ReadLimits, limits_of
from updyn.foreign.plain import encode
from updyn.foreign.settings import READING
from updyn.registry import load_object

__all__ = ["OUT_OF_MEMORY", "READY", "STATUS", "answer", "serve"]

#: First byte from the child, once all imports for reading are done.
READY = b"."
OUT_OF_MEMORY = "MemoryError"
#: Format of exit statuses from the fork server, for `struct`.
STATUS = "<i"


def serve() -> None:
    """Serve as a fork server: answer each request in a process forked for it.

    Standard input is a socket. Each line is a request of `answer`, as JSON text. The reply is one
    byte with the descriptor of the answer, and after the end of the process its exit status, as
    `STATUS`.
    """
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    control = socket.socket(fileno=0)
    control.settimeout(READING.idle_seconds)
    with contextlib.suppress(TimeoutError):
        for line in control.makefile("rb"):
            request = json.loads(line)
            with contextlib.suppress(Exception):  # the fork raises it again, and sends it
                load_object(request["load"])
            gc.freeze()
            received, sent = os.pipe()
            pid = os.fork()
            if pid == 0:
                _end_with(request, sent)
            os.close(sent)
            socket.send_fds(control, [b"."], [received])
            os.close(received)
            _, status = os.waitpid(pid, 0)
            control.sendall(struct.pack(STATUS, os.waitstatus_to_exitcode(status)))


def _end_with(request: Mapping[str, object], descriptor: int) -> NoReturn:
    status = 1
    try:
        answer(request, descriptor)
        gc.collect()  # freeing the objects of the reader may reveal corrupt memory
        status = 0
    finally:
        os._exit(status)  # a regular exit would take longer than reading


def answer(request: Mapping[str, Any], descriptor: int) -> None:
    """Load the file of a request as plain data, and write the answer to a file descriptor.

    The request has ``load`` (a text ``"module:function"``), ``path``, ``extra_files`` and
    ``arguments``.
    """
    path = request["path"]
    with os.fdopen(os.dup(descriptor), "wb") as out:
        _discard_output()
        found = _run_guarded(lambda: load_object(request["load"]))
        out.write(READY)
        out.flush()
        if "value" in found:
            load = found["value"]
            _set_limits(limits_of(path, request["extra_files"]))
            found = _run_guarded(lambda: load(path, *request["arguments"]))
        for part in encode(found):
            out.write(part)


def _discard_output() -> None:
    """Discard the output of readers, in Python or in C, and close their input."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)


def _run_guarded(act: Callable[[], object]) -> dict[str, Any]:
    """Return the result of a function as ``value``, else its error or the reason of the failure."""
    try:
        return {"value": act()}
    except InputError as error:
        place = {name: getattr(error, name, None) for name in ("path", "line")}
        return {"error": type(error).__name__, "text": str(error), "key": error.key, **place}
    except MemoryError:
        return {"failed": OUT_OF_MEMORY}
    # Libraries raise any exception for a damaged file; some end the process.
    except (Exception, SystemExit) as error:  # noqa: BLE001
        return {"failed": reason_of(error)}


def _set_limits(limits: ReadLimits) -> None:
    """Set the limits in the operating system, if supported."""
    try:
        import resource
    except ImportError:  # Windows: the parent process checks the time
        return
    # For an orphan, whose parent process was killed and no longer checks the time.
    seconds = int(limits.seconds + sum(os.times()[:2])) + 2
    memory = _program_size() + limits.memory
    for what, most in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CORE, 0),
    ):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(what, (most, most))


def _program_size() -> int:
    """Return the size of the address space of the program itself, in bytes."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 10**9
