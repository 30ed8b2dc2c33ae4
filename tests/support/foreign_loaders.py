"""What a library may do with a damaged file: loaders for the child process of `updyn.foreign.box`."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError
from updyn.foreign.plain import Other, Sparse


def crash(path: str) -> None:
    os.abort()


def hang(path: str) -> None:
    while True:
        time.sleep(0.01)


def allocate(path: str, count: int) -> int:
    return int(np.ones(count).sum())


def stop(path: str) -> None:
    raise SystemExit(1)


def refuse(path: str) -> None:
    raise FormatError("line of nonsense", path, 7, key=("x", 2))


_seen: list[str] = []


def remember(path: str, name: str) -> list[str]:
    """Return all names that this process has been given so far."""
    _seen.append(name)
    return _seen


def processes(path: str) -> list[int]:
    """Return the numbers of this process and of its parent process."""
    return [os.getpid(), os.getppid()]


def inherited(path: str) -> list[str]:
    """Return what a process inherits."""
    return [str(Path.cwd()), os.environ.get("UPDYN_TEST", ""), sys.path[-1]]


def talk(path: str) -> str:
    print("to Python's output")  # noqa: T201
    os.write(1, b"to the output of C")
    os.write(2, b"and its errors")
    return "the answer"


def everything(path: str) -> dict[str, Any]:
    """Return something of every kind that is plain data."""
    return {
        "none": None,
        "flags": [True, False],
        "numbers": [0, -(2**70), 1.5, float("inf")],
        "texts": ["", "é\n\0", "\udcff"],
        "empty": {},
        "arrays": [
            np.arange(6.0).reshape(2, 3).T,
            np.array([1 + 2j, np.nan]),
            np.array(7, dtype=">i2"),
            np.zeros((0, 3), dtype=bool),
            np.array(["a", "é"]),
            np.array([b"RX", b"X"]),
            np.array([["one", "three"]], dtype=object),
        ],
        "sparse": Sparse((2, 2), np.ones(1), np.array([1]), np.array([0, 0, 1])),
        "other": Other("opaque"),
    }
