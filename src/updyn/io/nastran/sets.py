"""Sets of elements of case control (``SET 5 = 1 THRU 20 EXCEPT 7, 30``), as labels of groups.

The syntax is that of the MSC Nastran Quick Reference Guide, case control command SET. A set does
not state whether it contains elements or grids; here its numbers are those of elements.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from updyn.io.nastran.fields import NastranLine

__all__ = ["NumberSet", "read_sets"]

_SET = re.compile(r"\s*SET\s+(\d+)\s*=\s*(.*)", re.IGNORECASE)
_RANGE = re.compile(r"(\d+)(?:\s+THRU\s+(\d+))?(?:\s+EXCEPT\s+(\d+))?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class NumberSet:
    """Numbers in `ranges` except those in `excluded`."""

    number: int
    ranges: tuple[range, ...]
    excluded: frozenset[int]

    @property
    def label(self) -> str:
        """Name of the set in patterns of groups."""
        return f"SET {self.number}"

    def select(self, numbers: Sequence[int]) -> set[int]:
        """Return the sorted numbers that are in the set."""
        found: set[int] = set()
        for one in self.ranges:
            found.update(numbers[bisect_left(numbers, one.start) : bisect_left(numbers, one.stop)])
        return found - self.excluded


def read_sets(case: Iterable[NastranLine]) -> list[NumberSet]:
    """Return the sets of case control; sets that are not lists of numbers are omitted."""
    # A later set of the same number replaces an earlier one.
    found: dict[int, NumberSet] = {}
    for number, text in _join_lines(case):
        numbers = _parse(number, text)
        if numbers is not None:
            found[number] = numbers
    return list(found.values())


def _join_lines(case: Iterable[NastranLine]) -> Iterator[tuple[int, str]]:
    """Yield number and text of each set; a line that ends with a comma goes on."""
    number: int | None = None
    text = ""
    for line in case:
        if number is None:
            start = _SET.fullmatch(line.text)
            if start is None:
                continue
            number, text = int(start[1]), start[2].strip()
        else:
            text += line.text.strip()
        if not text.endswith(","):
            yield number, text
            number = None


def _parse(number: int, text: str) -> NumberSet | None:
    ranges: list[range] = []
    excluded: set[int] = set()
    last = 0  # numbers after EXCEPT are excluded up to the end of their range
    for item in text.split(","):
        found = _RANGE.fullmatch(item.strip())
        if found is None:
            return None
        first = int(found[1])
        if found[2] is None and first <= last:
            excluded.add(first)
            continue
        ranges.append(range(first, int(found[2] or first) + 1))
        last = 0
        if found[3] is not None:
            excluded.add(int(found[3]))
            last = int(found[2])
    return NumberSet(number, tuple(ranges), frozenset(excluded))
