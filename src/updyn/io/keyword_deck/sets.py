"""Sets of nodes or elements in a deck, ``*NSET`` and ``*ELSET``.

One line can define any number of members, by GENERATE or by names of other sets; the number of
members is limited.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import IntArray
from updyn.errors import suggest
from updyn.io.keyword_deck.cards import KeywordCard, KeywordRow, parse_integer_field
from updyn.io.settings import DECK

__all__ = ["Sets", "concatenate", "distinct"]


_PER_LINE = 16  # numbers per line that both programs read


def concatenate(parts: Sequence[IntArray]) -> IntArray:
    """Return the arrays end to end; an empty array for no arrays."""
    return np.concatenate([np.empty(0, dtype=np.int64), *parts])


def distinct(numbers: IntArray) -> IntArray:
    """Return the distinct numbers, ascending."""
    # `numpy.unique` hashes integers since version 2.3, which takes a hundred times as long as
    # sorting for 2 million ascending numbers (numpy 2.5).
    found = np.sort(numbers)
    is_first = np.ones(len(found), dtype=np.bool_)
    is_first[1:] = found[1:] != found[:-1]
    return found[is_first]


class Sets:
    """Sets by name, in the order of the deck; GENERATE selects only from the numbers `known`."""

    def __init__(self, known: IntArray | None = None) -> None:
        self._known = None if known is None else distinct(known)
        self._parts: dict[str, list[IntArray]] = {}
        self._count = 0

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def add(self, name: str | None, members: IntArray) -> None:
        """Add members to a set and create it if necessary; ignore an empty name."""
        if name:
            self._parts.setdefault(name.upper(), []).append(members)

    def members(self, name: str) -> IntArray:
        """Return the members of a set (name in upper case), ascending."""
        found = distinct(concatenate(self._parts[name]))
        self._parts[name] = [found]
        return found

    def count(self, number: int, card: KeywordCard, row: KeywordRow | None = None) -> None:
        """Count members added by a line; raise a FormatError above the limit."""
        self._count += number
        if self._count > DECK.set_members:
            raise card.error(
                f"*{card.name}: the sets up to here have more than {DECK.set_members} members by"
                " GENERATE and by names of sets; expected fewer",
                row,
            )

    def add_card(self, card: KeywordCard) -> KeywordCard:
        """Add a set, which may refer to previous sets, and return an equivalent card."""
        # In this card GENERATE ends at the last existing number, and repeated members are removed,
        # so that programs read it in limited time.
        card.check_parameters(card.name, "GENERATE", "UNSORTED", "INTERNAL")
        name = card.require(card.name)
        if "GENERATE" in card.parameters:
            rows = [self._add_range(name, card, row) for row in card.rows]
            return replace(card, rows=tuple(row for row in rows if row is not None))
        found: list[IntArray] = []
        for row in card.rows:
            for text in filter(None, row.fields):
                if text.lstrip("-").isdecimal():
                    found.append(np.array([parse_integer_field(text, card, row)], dtype=np.int64))
                    continue
                if text.upper() not in self:
                    raise card.error(
                        f"*{card.name}: no set {text!r} so far; {suggest(text.upper(), [*self])}",
                        row,
                    )
                found.append(self.members(text.upper()))
                self.count(len(found[-1]), card, row)
        all_members = concatenate(found)
        members = distinct(all_members)
        self.add(name, members)
        return card if len(members) == len(all_members) else _list_members(card, members)

    def _add_range(self, name: str, card: KeywordCard, row: KeywordRow) -> KeywordRow | None:
        """Add the numbers of a line of GENERATE; return the line up to the last existing number."""
        fields = row.fields
        if len(fields) not in (2, 3):
            raise card.error(
                f"*{card.name}, GENERATE: found {row.text!r}; expected first, last, step", row
            )
        first, last, *given = [parse_integer_field(field, card, row) for field in fields]
        step = given[0] if given else 1
        if step < 1 or last < first:
            raise card.error(f"*{card.name}, GENERATE: {first} to {last} by {step} is empty", row)
        if self._known is None:
            self.count((last - first) // step + 1, card, row)
            self.add(name, np.arange(first, last + 1, step, dtype=np.int64))
            return row
        start, stop = np.searchsorted(self._known, [first, last + 1])
        self.count(int(stop - start), card, row)
        members = self._known[start:stop]
        members = members[(members - first) % step == 0]
        self.add(name, members)
        if not len(members):
            return None
        if members[-1] + step > last:
            return row
        return replace(row, text=f"{first}, {members[-1]}, {step}")


def _list_members(card: KeywordCard, members: IntArray) -> KeywordCard:
    texts = members.astype(str).tolist()
    lines = (texts[start : start + _PER_LINE] for start in range(0, len(texts), _PER_LINE))
    return replace(card, rows=tuple(KeywordRow(card.line, ", ".join(line)) for line in lines))
