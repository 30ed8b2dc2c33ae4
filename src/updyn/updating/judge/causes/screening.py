"""Selection of the elements that a model may lack, by their effect to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.settings import ROUNDING
from updyn.updating.judge.causes.element import AddedElement, ElementVectors
from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, MISSING_ELEMENT

__all__ = ["select_elements"]


_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True)
class _ScreenedElement:
    """An element with one of the trial sizes, and the remaining sum of squares."""

    element: AddedElement
    squared_error: float


def select_elements(
    evidence: Evidence, elements: Sequence[AddedElement], most: int
) -> list[AddedElement]:
    """Return the elements that explain the data best, to first order, with starting sizes."""
    if not elements:
        return []
    screening = _Screening(evidence)
    unit_stiffness = elements[0].unit_stiffness(evidence.receptances.s)
    flexibility = ElementVectors(evidence.receptances, elements).list_flexibilities(unit_stiffness)
    # At a moving base an element changes nothing.
    moves = flexibility > ROUNDING.receptance_share * flexibility.max()
    elements = [one for one, is_free in zip(elements, moves, strict=True) if is_free]
    units = (1.0 / flexibility[moves]).tolist()
    chosen = np.argsort(-screening.compute_gains(elements))[: MISSING_ELEMENT.most_sized]
    found = [screening.find_best_size(elements[i], units[i]) for i in chosen]
    found.sort(key=lambda one: one.squared_error)
    return [one.element for one in found[:most]]


@dataclass(frozen=True, slots=True, eq=False)
class _Screening:
    """Comparison of elements at a point."""

    evidence: Evidence

    def _stack(self, change: ComplexArray) -> RealArray:
        """Return a weighted change in units of the rms misfit, without a change of unknowns."""
        zeros = np.zeros(len(self.evidence.offset_to_start))
        return np.concatenate([stack_real_imag(change) / self.evidence.rms_misfit, zeros])

    def _stack_slope(self, element: AddedElement) -> RealArray:
        return self._stack(self.evidence.weight * self.evidence.receptances.slope(element))

    def compute_gains(self, elements: Sequence[AddedElement]) -> RealArray:
        """Return the decrease of the sum of squares by elements of one kind, from size 0."""
        # To first order, an element u changes the misfit by c (h_i u) (u^T h_j), with c by value.
        # Its products with the misfit and with the basis of the unknowns are forms u^T G u.
        if not elements:
            return np.zeros(0)
        evidence, R = self.evidence, self.evidence.receptances
        vectors = ElementVectors(R, elements)
        slope = R.derive_by_product(elements[0].unit_stiffness(R.s))
        c = np.asarray(evidence.weight / evidence.rms_misfit * slope)

        def multiply(v: RealArray) -> RealArray:
            real, imaginary = v[: c.size], v[c.size : 2 * c.size]
            return vectors.sum_products(np.asarray((real - 1j * imaginary).reshape(c.shape) * c))

        along = np.maximum(multiply(evidence.adapted_misfit), 0.0)
        imitated = sum(multiply(v) ** 2 for v in evidence.orthonormal_basis[0].T)
        size = vectors.sum_squares(c, MISSING_ELEMENT.chunk)
        least = CAUSE_MISFIT.dependent_share**2 * size + _TINY
        return np.asarray(along**2 / np.maximum(size - imitated, least))

    def find_best_size(self, element: AddedElement, unit: float) -> _ScreenedElement:
        """Return the element with the trial size that leaves the least residual after a step."""
        sized = [replace(element, value=size * unit) for size in MISSING_ELEMENT.sizes]
        return min((self._screen_element(one) for one in sized), key=lambda one: one.squared_error)

    def _screen_element(self, element: AddedElement) -> _ScreenedElement:
        weight, R = self.evidence.weight, self.evidence.receptances
        b = self.evidence.adapted_misfit
        if element.value:
            b = b - self.evidence.project_out_unknowns(self._stack(weight * R.log_change(element)))
        d = self.evidence.project_out_unknowns(self._stack_slope(element))
        step = float(d @ b) / max(float(d @ d), _TINY)
        low, high = 0.0, np.inf
        if element.value:
            low = -MISSING_ELEMENT.most_decrease * element.value
            high = MISSING_ELEMENT.most_increase * element.value
        b = b - float(np.clip(step, low, high)) * d
        return _ScreenedElement(element, float(b @ b))
