"""Selection of the elements that a model may lack, by their effect to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.settings import ROUNDING
from updyn.updating.judge.causes.element import AddedElement
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
    screening = _Screening(evidence)
    flexibility = [evidence.receptances.flexibility(one) for one in elements]
    # At a moving base an element changes nothing.
    least = ROUNDING.receptance_share * max(flexibility, default=0.0)
    elements = [one for one, size in zip(elements, flexibility, strict=True) if size > least]
    units = [1.0 / size for size in flexibility if size > least]
    starts = range(0, len(elements), MISSING_ELEMENT.chunk)
    chunks = [slice(start, start + MISSING_ELEMENT.chunk) for start in starts]
    gains = [screening.compute_gains(elements[chunk], units[chunk]) for chunk in chunks]
    chosen = np.argsort(-np.concatenate([*gains, np.zeros(0)]))[: MISSING_ELEMENT.most_sized]
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

    def compute_gains(self, elements: Sequence[AddedElement], units: Sequence[float]) -> RealArray:
        """Return the decrease of the sum of squares by each element, to first order from size 0."""
        D = np.array([self._stack_slope(replace(one, value=0.0)) for one in elements])
        D *= np.asarray(units)[:, None]
        along = np.maximum(D @ self.evidence.adapted_misfit, 0.0)
        imitated = D @ self.evidence.orthonormal_basis[0]
        size = np.sum(D**2, axis=1)
        least = CAUSE_MISFIT.dependent_share**2 * size + _TINY
        free = np.maximum(size - np.sum(imitated**2, axis=1), least)
        return np.asarray(along**2 / free)

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
