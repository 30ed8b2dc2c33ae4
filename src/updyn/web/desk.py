"""`Desk`: a separate process that reads files and solves models for the pages.

The server remains responsive, and a damaged file (time, memory, a crash) ends only that process.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import TypeVar, cast

from updyn.engines.interrupts import block_interrupts
from updyn.errors import InputError, UpdynError, UpdynWarning
from updyn.foreign.confinement import confine
from updyn.web.project import hide_folder
from updyn.web.settings import WEB_TASK

__all__ = ["Desk"]

T = TypeVar("T")


class Desk:
    """A process that is started on demand, calls functions and is kept for the next call.

    Files outside `folder` are not read. A call may take `seconds`, the process `memory` bytes (0:
    no limit).
    """

    def __init__(self, folder: Path, seconds: float, memory: int = 0) -> None:
        self._folder = folder
        self._seconds = seconds
        self._memory = memory
        self._context = multiprocessing.get_context("spawn")
        self._process: SpawnProcess | None = None
        self._line: Connection | None = None
        self._turn = threading.Lock()

    def ask(self, function: Callable[..., T], *arguments: object) -> T:
        """Call a module-level function with plain data in the process; concurrent calls wait.

        The result is plain data. An `UpdynError` of the function is raised here; an `InputError` if
        it exceeded its time or memory, or ended its process.
        """
        with self._turn:
            if self._process is None or not self._process.is_alive():
                self._begin()
            assert self._line is not None
            try:
                self._line.send((function, arguments))
                if not self._line.poll(self._seconds):
                    self._end()
                    raise InputError(
                        f"this took longer than {self._seconds:g} s and was ended; the command line"
                        " has no such limit"
                    )
                kind, content = self._line.recv()
            except (EOFError, OSError) as error:
                self._end()
                raise InputError(
                    "the process that read or solved this ended without an answer, which a damaged"
                    " file or too little memory can do"
                ) from error
        if kind == "error":
            raise InputError(hide_folder(content, self._folder))
        return cast(T, content)

    def close(self) -> None:
        """End the process once it has answered."""
        with self._turn:
            self._end()

    def end(self) -> None:
        """End the process at once; an active call raises `InputError`."""
        process = self._process
        if process is not None:
            process.kill()
        self.close()

    def _begin(self) -> None:
        self._end()
        self._line, other = self._context.Pipe()
        arguments = (other, self._folder, self._memory)
        process = self._context.Process(target=_answer_calls, args=arguments, daemon=True)
        with block_interrupts():
            process.start()
        self._process = process
        other.close()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join(WEB_TASK.kill_seconds)
            self._process = None
        if self._line is not None:
            self._line.close()
            self._line = None


def _answer_calls(line: Connection, folder: Path, memory: int) -> None:
    """Answer calls until the other end is closed; Ctrl-C in the terminal is for the server."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _limit_memory(memory)
    confine(folder)
    while True:
        try:
            function, arguments = line.recv()
        except (EOFError, OSError):
            return
        line.send(_answer(function, arguments))


def _answer(function: Callable[..., object], arguments: tuple[object, ...]) -> tuple[str, object]:
    """Return the kind and content of the result of a call; the run itself reports warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        try:
            return "result", function(*arguments)
        except UpdynError as error:
            return "error", str(error)
        except MemoryError:
            return "error", "not enough memory for this"


def _limit_memory(memory: int) -> None:
    """Limit the memory of this process, if the system supports it."""
    if memory <= 0:
        return
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
