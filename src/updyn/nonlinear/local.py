"""`LocalElement`: a nonlinear element with the combination of DOFs that it acts on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import ModelError
from updyn.nonlinear.element import NonlinearElement, check_number
from updyn.nonlinear.parameters import change_parameters

__all__ = ["LocalElement", "Place", "place_element"]

#: One DOF, two DOFs, or weights of DOFs.
Place = str | Dof | Iterable[str | Dof] | Mapping[str, float]


@dataclass(frozen=True, slots=True)
class LocalElement:
    """An element on the deformation u = sum of weight times displacement, by positive DOF label."""

    element: NonlinearElement
    weights: Mapping[str, float]

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (self.element, dict(self.weights))

    @property
    def rotates(self) -> bool | None:
        """Whether the deformation is a rotation in rad; None if weights may convert it to m."""
        rotates = {"R" in label for label in self.weights}
        if rotates == {False}:
            return False
        is_plain = {abs(weight) for weight in self.weights.values()} == {1.0}
        return True if rotates == {True} and is_plain else None

    def changed(self, values: Mapping[str, float]) -> LocalElement:
        """Return a copy with other values of some parameters."""
        return _rebuild(change_parameters(self.element, values), self.weights)

    def column(self, dofs: DofSet) -> RealArray:
        """Return the weight of each of N DOFs, shape (N,); DofError if one is missing."""
        out = np.zeros(len(dofs))
        out[dofs.match(self.weights).index] = list(self.weights.values())
        return out


def place_element(element: NonlinearElement, dofs: Place, what: str) -> LocalElement:
    """Return an element on one DOF, between two DOFs, or on DOFs with weights.

    `what` names the element in errors. Raises ModelError for another number of DOFs or another
    type of element, OptionError for a weight that is not finite, DofError for an invalid label.
    """
    if not hasattr(element, "over_period"):
        raise ModelError(
            f"{what}: expected a nonlinear element such as CubicSpring, found"
            f" {type(element).__name__}"
        )
    ends: list[str | Dof]
    if isinstance(dofs, Mapping):
        ends, signs = list(dofs), list(dofs.values())
    elif isinstance(dofs, str | Dof):
        ends, signs = [dofs], [1.0]
    else:
        ends, signs = list(dofs), [1.0, -1.0]
        if len(ends) not in (1, 2):
            raise ModelError(
                f"{what}: expected one degree of freedom, two, or a mapping of labels to weights;"
                f" found {len(ends)}"
            )
    if not ends:
        raise ModelError(f"{what}: expected at least one degree of freedom, found none")
    weights = {}
    for dof, weight in zip(DofSet(ends), signs, strict=False):
        check_number(f"{what}: weight of {dof}", weight, "1", least=-np.inf)
        weights[str(abs(dof))] = float(dof.sign * weight)
    if not any(weights.values()):
        raise ModelError(f"{what}: all weights are 0; expected one that is not")
    return _rebuild(element, weights)


def _rebuild(element: NonlinearElement, weights: Mapping[str, float]) -> LocalElement:
    return LocalElement(element, MappingProxyType(dict(weights)))
