"""Tests that take long: the marks `slow` and `long`, and an order for several workers.

The seconds are in `data/seconds.txt`, which `tools/slow_tests.py` writes from a log of pytest.
"""

from __future__ import annotations

import functools
from collections import defaultdict
from pathlib import Path

import pytest

from places import DATA, ROOT

SECONDS = DATA / "seconds.txt"
#: A test of so many seconds on a quiet core is slow: `make quick` is to take less than three
#: minutes on two cores.
SLOW = 0.5
#: A test of so many seconds is long: `.ci/run` leaves it out under the second Python and kernel.
LONG = 1.0


@functools.cache
def recorded() -> dict[str, float]:
    """Return the seconds of tests, and of files for the fixtures that their tests share."""
    lines = SECONDS.read_text(encoding="utf-8").splitlines()
    rows = [line.split(maxsplit=1) for line in lines if not line.startswith("#")]
    return {name: float(seconds) for seconds, name in rows}


@functools.cache
def by_file() -> dict[str, float]:
    """Return the seconds of each file that is named."""
    total: dict[str, float] = defaultdict(float)
    for name, seconds in recorded().items():
        total[name.partition("::")[0]] += seconds
    return dict(total)


@functools.cache
def file_of(path: Path) -> str:
    """Return the path of a file in the repository."""
    return path.relative_to(ROOT).as_posix()


def find_marks(path: Path, nodeid: str) -> list[str]:
    """Return the marks of a test by its seconds, or those of a fixture that its file shares."""
    file, test = file_of(path), nodeid.partition("::")[2].partition("[")[0]
    seconds = max(recorded().get(name, 0.0) for name in (file, f"{file}::{test}"))
    return [mark for mark, least in (("slow", SLOW), ("long", LONG)) if seconds >= least]


def sort_longest_first(items: list[pytest.Item]) -> None:
    """Sort tests by the seconds of their files; the order within a file is kept."""
    items.sort(key=lambda item: -by_file().get(file_of(item.path), 0.0))
