"""Candidate degrees of freedom, by labels and globs."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable

import numpy as np

from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, OptionError, key_path, suggest
from updyn.model import Model

__all__ = ["check_count", "find_candidates"]

_GLOB = frozenset("*?[")


def find_candidates(
    model: Model, given: str | Iterable[str | Dof] | None, key: str = "candidates"
) -> DofSet:
    """Return the candidates of labels and globs, each once, in order of appearance.

    None: all translational DOFs of the model, or all DOFs without any; ``"all"``: all DOFs. Labels
    keep their sign.
    """
    if given is None:
        moving = np.flatnonzero(model.dofs.axes < 3)
        return model.dofs[moving] if moving.size else model.dofs
    if isinstance(given, str):
        if given == "all":
            return model.dofs
        given = [given]
    if not isinstance(given, Iterable):
        raise DofError(f"{key}: expected labels or globs, found {given!r}", key=(key,))
    found: dict[Dof, Dof] = {}
    known = model.dofs.labels
    with key_path(key):
        for item in given:
            for dof in _match_candidates(known, item, key):
                found.setdefault(abs(dof), dof)
        candidates = DofSet(found.values())
        if not found:
            raise DofError(f"{key}: no candidate; expected labels or globs, such as '*:Z'")
        model.dofs.match(candidates, "candidate")
    return candidates


def _match_candidates(known: list[str], item: str | Dof, key: str) -> list[Dof]:
    """Return the DOFs of a label or a glob."""
    if not isinstance(item, str) or not _GLOB.intersection(item):
        return [Dof.parse(item)]
    fits = [label for label in known if fnmatch.fnmatchcase(label, item)]
    if not fits:
        raise DofError(f"{key}: no DOF of the model matches {item!r}; {suggest(item, known)}")
    return [Dof.parse(label) for label in fits]


def check_count(count: int, candidates: DofSet, key: str) -> None:
    """Raise OptionError unless the number to select is from 1 to the number of candidates."""
    whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
    if not whole or count < 1:
        raise OptionError(f"{key} = {count!r}: expected a whole number of at least 1", key=(key,))
    if count > len(candidates):
        noun = "candidate" if len(candidates) == 1 else "candidates"
        raise OptionError(
            f"{key} = {count}: found {len(candidates)} {noun}; name more, or"
            f" select at most {len(candidates)}",
            key=(key,),
        )
