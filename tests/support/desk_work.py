"""Functions for the process of `updyn.web.desk.Desk`, which imports what it calls by name."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path

import numpy as np

from updyn.errors import FormatError, UpdynWarning
from updyn.foreign.confinement import check_inside

_calls = [0]


def add(a: float, b: float) -> tuple[int, float]:
    """The sum, with the number of the process."""
    return os.getpid(), a + b


def count() -> int:
    """How often this was called in this process."""
    _calls[0] += 1
    return _calls[0]


def refuse(path: str) -> None:
    raise FormatError("line of nonsense", path, 7)


def warn() -> str:
    warnings.warn("of no interest here", UpdynWarning, stacklevel=1)
    return "warned"


def leave(code: int) -> None:
    os._exit(code)


def fail() -> None:
    raise ZeroDivisionError


def sleep(seconds: float) -> str:
    time.sleep(seconds)
    return "slept"


def sleep_beside(path: Path, seconds: float) -> None:
    """Say by a file that the sleep has begun."""
    path.write_text("begun", encoding="utf-8")
    time.sleep(seconds)


def allocate(n_bytes: int) -> float:
    return float(np.ones(n_bytes // 8)[-1])


def check(path: Path) -> str:
    check_inside(path)
    return "inside"


def unsendable() -> object:
    return lambda: None
