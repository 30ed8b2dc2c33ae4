"""The child process of `updyn.foreign.box` forked from this one, which holds all imports: 20 ms instead of 0.5 s."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from updyn.foreign import box
from updyn.foreign.child import answer
from updyn.registry import load_object


class Forked:
    """What `subprocess.Popen` is for `updyn.foreign.box`; it reads, limits itself and answers as a new process does."""

    def __init__(self, command: Sequence[str], **_: Any) -> None:
        request = json.loads(command[-1])
        load_object(request["load"])  # imported here, once
        received, sent = os.pipe()
        self._pid = os.fork()
        if not self._pid:
            _answer(request, sent)
        os.close(sent)
        self._status: int | None = None
        self.stdout = os.fdopen(received, "rb", buffering=0)

    def __enter__(self) -> Forked:
        return self

    def __exit__(self, *_: object) -> None:
        self.stdout.close()
        self.wait()

    def wait(self, timeout: float | None = None) -> int:
        """Return how the process ended."""
        until = None if timeout is None else time.monotonic() + timeout
        while self._status is None:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            if pid:
                self._status = os.waitstatus_to_exitcode(status)
            elif until is not None and time.monotonic() > until:
                raise subprocess.TimeoutExpired("forked", timeout or 0.0)
            else:
                time.sleep(0.001)
        return self._status

    def kill(self) -> None:
        """End the process."""
        if self._status is None:
            os.kill(self._pid, 9)


def _answer(request: dict[str, Any], sent: int) -> None:
    """Be the child."""
    code = 1
    try:
        os.dup2(sent, 1)
        os.close(sent)
        answer(request)
        code = 0
    finally:
        os._exit(code)


_STANDS_IN = SimpleNamespace(
    Popen=Forked,
    DEVNULL=subprocess.DEVNULL,
    PIPE=subprocess.PIPE,
    TimeoutExpired=subprocess.TimeoutExpired,
)


@contextmanager
def forked_readers() -> Iterator[None]:
    """Fork the child processes of `updyn.foreign.box`."""
    real = box.subprocess
    box.subprocess = _STANDS_IN
    try:
        yield
    finally:
        box.subprocess = real
