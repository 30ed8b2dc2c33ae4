"""Docstrings of public names have examples, and what these show comes out."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from pages import ROOT


def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("doctests", ROOT / "tools" / "doctests.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOOL = tool()
TESTS = {name: TOOL.examples(name, thing) for name, thing in TOOL.public_objects()}
SHOWN = [test for tests in TESTS.values() for test in tests]


@pytest.mark.parametrize("test", SHOWN, ids=lambda test: test.name)
def test_the_example_holds(test) -> None:
    # As numpy prints by itself: another library of the tests changes that for the whole process.
    with np.printoptions(legacy=False):
        assert TOOL.failure(test) == ""


def test_a_wrong_example_is_seen() -> None:
    def wrong() -> None:
        """Return nothing.

        >>> 1 + 1
        3
        """

    (test,) = TOOL.examples("wrong", wrong)
    assert "Expected:\n    3\nGot:\n    2" in TOOL.failure(test)


def test_every_public_name_has_an_example() -> None:
    public = {name for name in TESTS if name.count(".") == 1}
    assert [name for name in sorted(public) if not TESTS[name]] == []
