"""`ChangedUpdate`: the updated model and its unknowns after a change of the structure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, RealArray
from updyn.errors import OptionError
from updyn.group import VALUES, Matrix
from updyn.model import Model
from updyn.modification.settings import MODIFICATION
from updyn.uncertainty.restored import estimate_of
from updyn.updating.problem.parameters import Drive, ParameterSet
from updyn.updating.result import UpdateResult

__all__ = ["ChangedUpdate", "change_update"]

#: A change of a model, such as ``lambda model: model.with_element(...)``.
Change = Callable[[Model], Model]


@dataclass(frozen=True, slots=True, eq=False)
class ChangedUpdate:
    """An update of which `result` has the changed start model.

    `kept` has the positions of the unknowns that still act, of `n`: a damping value that the change
    states replaces an unknown.
    """

    result: UpdateResult
    kept: IndexArray
    n: int

    def expand(self, derivatives: RealArray) -> RealArray:
        """Return derivatives (..., n) by all unknowns, from those by the unknowns that act."""
        found = np.zeros((*derivatives.shape[:-1], self.n), dtype=derivatives.dtype)
        found[..., self.kept] = derivatives
        return found


def change_update(result: UpdateResult, change: Change) -> ChangedUpdate:
    """Apply a change to start and updated model; OptionError if the unknowns do not follow it."""
    changed = _apply(change, result.model)
    kept = [
        position
        for position, parameter in enumerate(result.parameters)
        if not any(
            drive.quantity in VALUES
            and _value(changed, drive) not in (None, _value(result.model, drive))
            for drive in parameter.acts_on
        )
    ]
    if not kept:
        raise OptionError("change: it states the values of all unknowns; nothing is uncertain")
    parameters = ParameterSet(tuple(result.parameters[i] for i in kept))
    after = replace(
        result,
        start=_apply(change, result.start),
        model=changed,
        parameters=parameters,
        values={p.name: result.values[p.name] for p in parameters},
        std={p.name: result.std[p.name] for p in parameters},
        covariance=result.covariance[np.ix_(kept, kept)],
        kept_basis=None,
    )
    expected = parameters.apply(after.start, estimate_of(after))
    for name, what in _find_differences(expected, changed):
        raise OptionError(
            f"change: that of {what} of group {name!r} depends on the values of the unknowns;"
            " expected the same change of the model before and after the update, such as a factor"
        )
    return ChangedUpdate(after, np.array(kept, dtype=np.intp), len(result.parameters))


def _apply(change: Change, model: Model) -> Model:
    """Return the changed model; OptionError if it is no model of the same DOFs."""
    changed = change(model)
    if not isinstance(changed, Model):
        raise OptionError(f"change: expected a function that returns a Model, found {changed!r}")
    if changed.dofs != model.dofs:
        raise OptionError(
            f"change: the model has {changed.n_dofs} DOFs afterwards, and {model.n_dofs} before;"
            " expected the same DOFs"
        )
    return changed


def _value(model: Model, drive: Drive) -> float | None:
    """Return the damping value on which an unknown acts; None if the model lacks the group."""
    return getattr(model.groups.get(drive.group), drive.quantity, None)


def _find_differences(expected: Model, found: Model) -> Iterator[tuple[str, str]]:
    """Yield groups and quantities in which two models differ by more than rounding."""
    for name in {*expected.groups, *found.groups}:
        if name not in expected.groups or name not in found.groups:
            yield name, "the presence"
            continue
        a, b = expected.groups[name], found.groups[name]
        for what in ("stiffness", "mass", "viscous"):
            if not _are_equal(getattr(a, what), getattr(b, what)):
                yield name, what
        for what in VALUES:
            if not np.isclose(getattr(a, what), getattr(b, what), MODIFICATION.rounding, 0.0):
                yield name, what


def _are_equal(a: Matrix | None, b: Matrix | None) -> bool:
    """Return whether two matrices are equal but for rounding."""
    if a is None or b is None:
        return a is b
    difference, size = abs(sp.csr_array(a) - sp.csr_array(b)), abs(sp.csr_array(b))
    return bool(difference.max() <= MODIFICATION.rounding * size.max())
