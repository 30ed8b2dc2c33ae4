"""`merge_groups`: several groups as one, for one unknown of all of them.

The matrices of the merged group are sums, so its damping must be that of each of its members.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.errors import ModelError, key_path
from updyn.exchanged import AxisExchange, StiffnessAndMass
from updyn.group import GROUP_QUANTITIES, MATRICES, VALUES, Group, LossTable, Matrix
from updyn.grouping import GroupOrigin, find_groups, suggest_groups

__all__ = ["merge_groups", "split_changes"]


def merge_groups(groups: Mapping[str, Group], merged: Mapping[str, object]) -> dict[str, Group]:
    """Return groups with some of them merged.

    Parameters
    ----------
    groups : mapping of str to Group
        The groups by name.
    merged : mapping of str to str or iterable of str
        Patterns (`updyn.grouping`) by name of the new group.

    Returns
    -------
    dict of str to Group
        The groups; a new group is at the place of its first member.

    Raises
    ------
    ModelError
        If a pattern selects no group, a group belongs to two new ones, a name is that of another
        group, or the damping of the members differs.
    """
    with key_path("groups"):
        new_name = _assign_groups(groups, merged)
        found: dict[str, Group] = {}
        for name, group in groups.items():
            target = new_name.get(name)
            if target is None:
                found[name] = group
            elif target not in found:
                chosen = {one: groups[one] for one in groups if new_name.get(one) == target}
                with key_path(target):
                    found[target] = _merge(target, chosen)
    return found


def split_changes(
    groups: Mapping[str, Group], changes: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]]:
    """Return changes by original group.

    Parameters
    ----------
    groups : mapping of str to Group
        The groups by name.
    changes : mapping of str to mapping of str to float
        Changes by group, as for `Model.scaled`.

    Returns
    -------
    dict of str to dict of str to float
        Each member of a merged group has the changes of the matrices that it has.
    """
    found: dict[str, dict[str, float]] = {}
    for name, change in changes.items():
        members = groups[name].origin.members if name in groups else {}
        if not members:
            found[name] = dict(change)
        for member, matrices in members.items():
            own = {q: value for q, value in change.items() if GROUP_QUANTITIES[q] in matrices}
            if own:
                found[member] = own
    return found


def _assign_groups(groups: Mapping[str, Group], merged: Mapping[str, object]) -> dict[str, str]:
    if not isinstance(merged, Mapping) or not merged:
        raise ModelError(f"groups: expected names with patterns, found {merged!r}")
    new_name: dict[str, str] = {}
    for target, given in merged.items():
        with key_path(target):
            for pattern in _list_patterns(target, given):
                for name in _find(groups, target, pattern):
                    other = new_name.setdefault(name, target)
                    if other != target:
                        raise ModelError(
                            f"groups: {name!r} is in {other!r} and in {target!r}; expected one of"
                            " them"
                        )
    for target in merged:
        if target in groups and target not in new_name:
            raise ModelError(
                f"groups: {target!r} is the name of another group; expected a new name",
                key=(target,),
            )
    return new_name


def _list_patterns(target: str, given: object) -> Sequence[str]:
    patterns = given
    if isinstance(given, str):
        patterns = [given]
    expected = "expected a pattern or a list of them"
    if not isinstance(patterns, Iterable) or isinstance(patterns, Mapping):
        raise ModelError(f"groups: {target}: {expected}, found {given!r}")
    patterns = list(patterns)
    if not patterns:
        raise ModelError(f"groups: {target}: {expected}, found {given!r}")
    for pattern in patterns:
        if not isinstance(pattern, str):
            raise ModelError(f"groups: {target}: {expected}, found {pattern!r}")
    return patterns


def _find(groups: Mapping[str, Group], target: str, pattern: str) -> list[str]:
    found = find_groups(groups, pattern)
    if not found:
        near = suggest_groups(pattern, groups)
        raise ModelError(f"groups: {target}: no group {pattern!r}; {near}")
    return found


def _merge(target: str, members: Mapping[str, Group]) -> Group:
    """Return the sum of groups of equal damping."""
    damping: dict[str, Any] = {name: _common_value(target, members, name) for name in VALUES}
    damping["loss_table"] = _common_table(target, members)
    K, M, C = (_sum(getattr(group, what) for group in members.values()) for what in MATRICES)
    merged = Group(K, M, viscous=C, **damping).with_exchanged(_exchange_axes(members))
    return merged.with_origin(_merge_origins(members))


def _sum(matrices: Iterable[Matrix | None]) -> Matrix | None:
    total = None
    for matrix in matrices:
        if matrix is not None:
            total = matrix if total is None else total + matrix
    return total


def _common_value(target: str, members: Mapping[str, Group], quantity: str) -> float:
    """Return the damping coefficient of all members with the matrix on which it acts."""
    able = {name: group for name, group in members.items() if group.has(quantity)}
    if not able:
        return 0.0
    first, *_ = able
    expected = able[first].value(quantity)
    for name, group in able.items():
        value = group.value(quantity)
        if value != expected:
            raise ModelError(
                f"groups: {target}: {quantity} is {expected:g} in {first!r} and {value:g} in"
                f" {name!r}; expected equal damping in all groups to merge"
            )
    return expected


def _common_table(target: str, members: Mapping[str, Group]) -> LossTable | None:
    able = {name: group for name, group in members.items() if group.stiffness is not None}
    if not able:
        return None
    first, *_ = able
    expected = able[first].loss_table
    for name, group in able.items():
        if not _is_same_table(expected, group.loss_table):
            raise ModelError(
                f"groups: {target}: loss_table differs between {first!r} and {name!r}; expected"
                " equal damping in all groups to merge"
            )
    return expected


def _is_same_table(a: LossTable | None, b: LossTable | None) -> bool:
    if a is None or b is None:
        return a is b
    return np.array_equal(a.freq, b.freq) and np.array_equal(a.relative, b.relative)


def _merge_origins(members: Mapping[str, Group]) -> GroupOrigin:
    """Return the original groups, and the materials and sets that all members share."""
    originals: dict[str, tuple[str, ...]] = {}
    named: dict[str, None] = {}
    common: set[str] | None = None
    for name, group in members.items():
        has = tuple(what for what in MATRICES if getattr(group, what) is not None)
        originals |= group.origin.members or {name: has}
        named |= dict.fromkeys((*group.origin.labels, *group.origin.partial))
        labels = set(group.origin.labels)
        common = labels if common is None else common & labels
    shared = tuple(label for label in named if label in (common or ()))
    return GroupOrigin(shared, tuple(label for label in named if label not in shared), originals)


@dataclass(frozen=True, slots=True, eq=False)
class _MergedRecipe:
    """The recipe of a merged group: its beams with exchanged axes, and its other members."""

    exchanged: tuple[AxisExchange, ...]
    others: tuple[Group, ...]

    def matrices(self) -> StiffnessAndMass:
        parts: list[StiffnessAndMass | Group] = [
            *self.others,
            *(one.matrices() for one in self.exchanged),
        ]
        return StiffnessAndMass(_sum(p.stiffness for p in parts), _sum(p.mass for p in parts))


def _exchange_axes(members: Mapping[str, Group]) -> AxisExchange | None:
    """Return the group with the section axes of all its beams exchanged; None without beams."""
    exchanged = [group.exchanged for group in members.values() if group.exchanged is not None]
    if not exchanged:
        return None
    others = [group for group in members.values() if group.exchanged is None]
    what = "; ".join(dict.fromkeys(one.what for one in exchanged))
    turn = "; ".join(dict.fromkeys(one.turn for one in exchanged if one.turn))
    return AxisExchange(_MergedRecipe(tuple(exchanged), tuple(others)), what, turn)
