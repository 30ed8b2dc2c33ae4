"""The recorded seconds of slow tests: their names exist, a log is read as it is printed."""

from __future__ import annotations

import importlib.util
import re
from typing import Any

import pytest

import slow
from places import ROOT

LOG = """\
============================= slowest durations ==============================
92.35s setup    tests/docs/test_a.py::test_b[compare]
4.00s call     tests/docs/test_a.py::test_b[one - x]
6.50s call     tests/docs/test_a.py::test_b[two]
0.10s call     tests/docs/test_a.py::test_c
0.10s teardown tests/docs/test_a.py::test_c
"""


def tool() -> Any:
    spec = importlib.util.spec_from_file_location("slow_tests", ROOT / "tools" / "slow_tests.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_names_exist() -> None:
    """Else: record the seconds anew by tools/slow_tests.py, or correct the name."""
    for name in slow.recorded():
        file, _, test = name.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not test or re.search(rf"^\s*def {test.split('::')[-1]}\(", text, re.MULTILINE), name


def test_a_log_is_read() -> None:
    """A setup counts for its file, the longest run for a test with parameters."""
    assert tool().seconds(LOG) == {
        "tests/docs/test_a.py": 92.35,
        "tests/docs/test_a.py::test_b": 6.5,
    }


def test_which_are_slow_and_long(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {"tests/a.py::test_all": 0.5, "tests/a.py::test_short": 0.4, "tests/b.py": 1.0}
    monkeypatch.setattr(slow, "recorded", lambda: rows)
    for file, name, expected in (
        ("a.py", "test_all[x::y]", ["slow"]),
        ("a.py", "test_short", []),
        ("a.py", "test_other", []),
        ("b.py", "test_any", ["slow", "long"]),
    ):
        assert slow.find_marks(ROOT / "tests" / file, f"tests/{file}::{name}") == expected


def test_the_longest_file_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    class Item:
        def __init__(self, file: str, number: int) -> None:
            self.path, self.number = ROOT / file, number

    monkeypatch.setattr(slow, "by_file", lambda: {"tests/b.py": 9.0, "tests/c.py": 20.0})
    items = [Item(f"tests/{name}.py", number) for name in "abc" for number in (1, 2)]
    slow.sort_longest_first(items)
    assert [(item.path.stem, item.number) for item in items] == [
        (name, number) for name in "cba" for number in (1, 2)
    ]
