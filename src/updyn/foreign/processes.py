"""Processes that read one file each: forks of a server that holds all imports, or new processes.

Starting Python and importing a library takes much longer than reading a file. On Linux a fork
server does that once and forks one process per request; it reads no file itself, so that no reading
can affect the next one.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from updyn.foreign.child import STATUS
from updyn.foreign.settings import READING

__all__ = ["Forked", "start"]

_NEW = "from updyn.foreign.child import answer; answer(json.loads(sys.argv[2]), 1)"
_SERVER = "from updyn.foreign.child import serve; serve()"
#: Threads of BLAS and numexpr use address space without computing anything, and prevent forks.
_THREADS = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
#: On other systems, libraries do not survive a fork, or there is no fork.
_CAN_FORK = sys.platform == "linux"


def start(request: Mapping[str, object]) -> subprocess.Popen[bytes] | Forked:
    """Start a process that answers a request of `updyn.foreign.child.answer` on its ``stdout``."""
    text = json.dumps(request)
    for server in _servers() if _CAN_FORK else ():
        forked = server.fork(text)
        if forked is not None:
            return forked
    return _python(_NEW, text, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)


def _python(code: str, *arguments: str, **options: Any) -> subprocess.Popen[bytes]:
    """Start Python with the module path of this process."""
    prepared = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); {code}"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", prepared, json.dumps(list(map(str, sys.path))), *arguments],
        bufsize=0,
        stderr=subprocess.DEVNULL,
        env=os.environ | _THREADS,
        **options,
    )


# -- the fork server ------------------------------------------------------------------------------
class _Server:
    """A fork server, which serves one request at a time and inherited the state `origin`."""

    def __init__(self, origin: tuple[object, ...]) -> None:
        self.origin = origin
        self.control, child_socket = socket.socketpair()
        with child_socket:
            # A separate process group: killed with its fork, and not reached by Ctrl-C.
            self.process = _python(
                _SERVER, stdin=child_socket, stdout=subprocess.DEVNULL, process_group=0
            )

    def fork(self, request: str) -> Forked | None:
        """Return a process that answers a request, or None if the server has ended."""
        forked = None
        self.control.settimeout(READING.start_seconds)
        try:
            with contextlib.suppress(OSError):  # idle for too long, or after the time limit
                self.control.sendall(request.encode() + b"\n")
                _, descriptors, *_ = socket.recv_fds(self.control, 1, 1)
                forked = Forked(self, descriptors[0]) if descriptors else None
        finally:
            if forked is None:
                self.end()
        return forked

    def status(self, timeout: float | None) -> int:
        self.control.settimeout(timeout)
        try:
            (status,) = struct.unpack(STATUS, self.control.recv(struct.calcsize(STATUS)))
        except (TimeoutError, BlockingIOError) as error:
            raise subprocess.TimeoutExpired("reader", timeout or 0.0) from error
        except (OSError, struct.error):  # the server was killed
            return -signal.SIGKILL
        return int(status)

    def end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.control.close()


class Forked:
    """A process forked by a server, with the used part of the interface of `subprocess.Popen`."""

    def __init__(self, server: _Server, descriptor: int) -> None:
        self._server = server
        self._status: int | None = None
        self.stdout = os.fdopen(descriptor, "rb", buffering=0)

    def __enter__(self) -> Forked:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self.stdout.close()

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit status; raise subprocess.TimeoutExpired after `timeout` seconds."""
        if self._status is None:
            self._status = self._server.status(timeout)
            _idle.append(self._server)
        return self._status

    def kill(self) -> None:
        """End the process and the server."""
        if self._status is None:
            self._status = -signal.SIGKILL
            self._server.end()


# -- idle servers ---------------------------------------------------------------------------------
_idle: list[_Server] = []


def _servers() -> Iterator[_Server]:
    """Yield usable servers: idle ones, then a new one."""
    origin = _origin()
    with contextlib.suppress(IndexError):  # none is idle, or another thread took the last one
        while server := _idle.pop():
            if server.origin == origin:
                yield server
            else:
                server.end()
    yield _Server(origin)


def _origin() -> tuple[object, ...]:
    """Return the state that a process inherits: environment, working folder and module path."""
    folder = Path().stat()
    return dict(os.environ), (folder.st_dev, folder.st_ino), tuple(map(str, sys.path))


@atexit.register
def _end_all() -> None:
    while _idle:
        _idle.pop().end()


def _forget() -> None:
    """Leave the servers to the parent process after a fork."""
    for server in _idle:
        server.control.close()
        server.process.returncode = 0
    _idle.clear()


if _CAN_FORK:
    os.register_at_fork(after_in_child=_forget)
