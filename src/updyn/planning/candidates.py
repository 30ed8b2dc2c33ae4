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
    """Return the candidates that labels and globs stand for.

    Parameters
    ----------
    model : Model
        The structure.
    given : None, str or iterable of str or Dof
        None: all translational DOFs of the model, or all DOFs where none is translational.
        ``"all"``: all DOFs. Else labels, which keep their sign, and globs, such as ``"*:Z"``.
    key : str
        Name of the argument, for messages.

    Returns
    -------
    DofSet
        Each once, in the order in which it was first named.

    Raises
    ------
    DofError
        If a label cannot be read or is not in the model, a glob fits none, or there is none at all.
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
            for dof in _fitting(known, item, key):
                found.setdefault(abs(dof), dof)
        candidates = DofSet(found.values())
        if not found:
            raise DofError(f"{key}: none is named; expected labels or globs, such as '*:Z'")
        model.dofs.match(candidates, "candidate")
    return candidates


def _fitting(known: list[str], item: str | Dof, key: str) -> list[Dof]:
    """Return the DOFs that a label or a glob stands for."""
    if not isinstance(item, str) or not _GLOB.intersection(item):
        return [Dof.parse(item)]
    fits = [label for label in known if fnmatch.fnmatchcase(label, item)]
    if not fits:
        raise DofError(f"{key}: no DOF of the model fits {item!r}; {suggest(item, known)}")
    return [Dof.parse(label) for label in fits]


def check_count(count: int, candidates: DofSet, key: str) -> None:
    """Check how many of the candidates are to be chosen.

    Parameters
    ----------
    count : int
        How many.
    candidates : DofSet
        Out of which.
    key : str
        Name of the argument, for messages.

    Raises
    ------
    OptionError
        If it is not a whole number from 1 to that of the candidates.
    """
    whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
    if not whole or count < 1:
        raise OptionError(f"{key} = {count!r}: expected a whole number of at least 1", key=(key,))
    if count > len(candidates):
        there = "candidate" if len(candidates) == 1 else "candidates"
        raise OptionError(
            f"{key} = {count}: there are {len(candidates)} {there} to choose from; name more, or"
            f" choose at most {len(candidates)}",
            key=(key,),
        )
