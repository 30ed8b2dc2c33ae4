"""What the engines are given to do: functions that another process can import."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import SolverError


class Shared:
    """Large and immutable, but for a cache that is not sent; notes each time it is received."""

    def __init__(self, folder: Path, size: int = 50) -> None:
        self.folder = folder
        self.matrix = np.random.default_rng(size).standard_normal((size, size))
        self.cache: list[Any] = []

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "cache": []}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        (self.folder / f"received-{os.getpid()}-{time.monotonic_ns()}").touch()

    def received(self) -> int:
        return len(list(self.folder.glob("received-*")))


def contract(shared: Shared, item: int) -> np.ndarray:
    return np.sin(item * shared.matrix) @ shared.matrix[:, :3]


def call_of(shared: Shared, item: object) -> tuple[int, int]:
    """Return the process, and which of the calls it is that found this very object there."""
    shared.cache.append(item)
    return os.getpid(), len(shared.cache)


def fail_at_3(_: Shared, item: int) -> int:
    if item == 3:
        raise SolverError("line 3 at 12.5 Hz cannot be solved")
    return item


def behind_gate(shared: Shared, item: int) -> tuple[int, int]:
    """Return at once for item 0; otherwise note the start and wait for the file ``gate``."""
    if item:
        (shared.folder / f"started-{item}").touch()
        while shared.folder.exists() and not (shared.folder / "gate").exists():
            time.sleep(0.01)
    return item, 7 * item


def fail_before_gate(shared: Shared, item: int) -> tuple[int, int]:
    return behind_gate(shared, item) if item else (fail_at_3(shared, 3), 0)


def end_process() -> None:
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))


def die_once(shared: Shared, item: int) -> int:
    """Kill the process that gets item 4, the first time."""
    note = shared.folder / "died"
    if item == 4 and not note.exists():
        note.touch()
        end_process()
    return 7 * item


def die_always(_: Shared, item: int) -> int:
    if item == 4:
        end_process()
    return item


def environment(_: object, name: str) -> str | None:
    return os.environ.get(name)


def seen_as_leaking(_: object, item: int) -> int:
    """Make loky's check for leaks strike at the next occasion."""
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = -1
    process_executor._MEMORY_LEAK_CHECK_DELAY = -1.0
    return os.getpid()


def objects_held(_: object, item: int) -> int:
    from updyn.engines import processes

    return len(processes._SHARED_OBJECTS)


def total(shared: list[np.ndarray], item: int) -> float:
    return float(sum(a.sum() for a in shared)) + item


def wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.02)
