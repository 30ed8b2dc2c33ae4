"""Limits on files that include other files."""

from __future__ import annotations

from pathlib import Path

from updyn.io.inclusion import Inclusions


def test_a_file_can_be_included_a_hundred_times_again():
    inclusions = Inclusions()
    assert [inclusions.excess(Path("a.inp"), 1) for _ in range(101)] == [None] * 101
    assert inclusions.excess(Path("b.inp"), 10**9) is None  # the first time
    assert inclusions.excess(Path("a.inp"), 1) == "more than 100 repeated inclusions"


def test_files_that_are_included_again_have_a_million_lines_at_most():
    inclusions = Inclusions()
    assert [inclusions.excess(Path("a.inp"), 500_000) for _ in range(3)] == [None] * 3
    assert inclusions.excess(Path("b.inp"), 1) is None
    message = "repeated inclusions have more than 1000000 lines in total"
    assert inclusions.excess(Path("b.inp"), 1) == message
