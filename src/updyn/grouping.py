"""Selection of groups by patterns: names, globs, ranges of numbers, materials and sets.

A pattern is, in this order:

- the name of a group;
- a glob, such as ``"CONM2 10*"``, or a range of the integer in the names, such as ``"PSHELL 1-4"``,
  or both, such as ``"wing 1-4*"``;
- for `find_groups`, a label that the reader of the model gave to groups: a material (``"MAT1 3"``)
  or a set of elements (``"SET 5"``).
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Collection, Container, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

from updyn.errors import ModelError, suggest

__all__ = [
    "GroupOrigin",
    "HasOrigin",
    "find_groups",
    "label_groups",
    "list_labels",
    "match_names",
    "suggest_groups",
]

#: A bracket expression of a glob, which is skipped, or a range of integers.
_RANGE = re.compile(r"\[[^\]]*\]|(?<!\d)(\d+)-(\d+)(?!\d)")
_INTEGER = re.compile(r"\d+")


@dataclass(frozen=True, slots=True)
class GroupOrigin:
    """Description of a group in the source of its model.

    Parameters
    ----------
    labels : tuple of str
        Materials of the group, and sets with all its elements.
    partial : tuple of str
        Sets with some of its elements, and materials of some of its members.
    members : mapping of str to tuple of str
        For a merged group: the original groups by name, with the names of their matrices.
    """

    labels: tuple[str, ...] = ()
    partial: tuple[str, ...] = ()
    members: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def __reduce__(self) -> tuple[object, ...]:
        return GroupOrigin, (self.labels, self.partial, dict(self.members))


class HasOrigin(Protocol):
    """A group, as far as its selection is concerned."""

    @property
    def origin(self) -> GroupOrigin:
        """The description of the group in its source."""


def match_names(names: Iterable[str], pattern: str) -> list[str]:
    """Return the names that match a pattern without labels; case-sensitive.

    Parameters
    ----------
    names : iterable of str
        The names.
    pattern : str
        Name, glob or range.

    Returns
    -------
    list of str
        The matching names, in order.
    """
    names = list(names)
    if pattern in names:
        return [pattern]
    ends = next((found for found in _RANGE.finditer(pattern) if found[1]), None)
    if ends is None:
        return [name for name in names if fnmatch.fnmatchcase(name, pattern)]
    return [name for name in names if _is_in_range(name, pattern, ends)]


def _is_in_range(name: str, pattern: str, ends: re.Match[str]) -> bool:
    low, high = int(ends[1]), int(ends[2])
    for number in _INTEGER.finditer(name):
        literal = name[: number.start()] + ends[0] + name[number.end() :]
        if low <= int(number[0]) <= high and fnmatch.fnmatchcase(literal, pattern):
            return True
    return False


def find_groups(groups: Mapping[str, HasOrigin], pattern: str) -> list[str]:
    """Return the names of the groups that a pattern selects.

    Parameters
    ----------
    groups : mapping of str to Group
        The groups by name.
    pattern : str
        Name, glob, range, material or set.

    Returns
    -------
    list of str
        Names in the order of the groups; empty without any.

    Raises
    ------
    ModelError
        If the pattern is a set that contains only some elements of a group.
    """
    found = match_names(groups, pattern)
    if found:
        return found
    for name, group in groups.items():
        if pattern in group.origin.partial:
            raise ModelError(
                f"{pattern!r} contains only a part of group {name!r}; expected whole groups: give"
                " these elements a separate property"
            )
    return [name for name, group in groups.items() if pattern in group.origin.labels]


def label_groups(
    elements: Mapping[str, Collection[int]], sets: Mapping[str, Container[int]]
) -> dict[str, GroupOrigin]:
    """Return the sets that contain all or some elements of each group.

    Parameters
    ----------
    elements : mapping of str to collection of int
        Numbers of the elements by group.
    sets : mapping of str to container of int
        Numbers of the elements by label of the set.

    Returns
    -------
    dict of str to GroupOrigin
        By group.
    """
    origins = {}
    for name, numbers in elements.items():
        counts = {label: sum(n in members for n in numbers) for label, members in sets.items()}
        whole = [label for label, count in counts.items() if 0 < count == len(numbers)]
        partial = [label for label, count in counts.items() if 0 < count < len(numbers)]
        origins[name] = GroupOrigin(tuple(whole), tuple(partial))
    return origins


def list_labels(groups: Iterable[HasOrigin]) -> list[str]:
    """Return the materials and sets of groups, each once.

    Parameters
    ----------
    groups : iterable of Group
        The groups.

    Returns
    -------
    list of str
    """
    return list(dict.fromkeys(label for group in groups for label in group.origin.labels))


def suggest_groups(pattern: str, groups: Mapping[str, HasOrigin]) -> str:
    """Return the end of an error message about a pattern that selects no group.

    Parameters
    ----------
    pattern : str
        The pattern.
    groups : mapping of str to Group
        The groups by name.

    Returns
    -------
    str
    """
    return suggest(pattern, [*groups, *list_labels(groups.values())])
