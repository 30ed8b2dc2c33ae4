"""Selection of the elements that a model may lack, by their effect to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.judge.causes.element import AddedElement
from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.misfit import compute_log_misfit
from updyn.updating.judge.causes.settings import MISSING_ELEMENT

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
    misfit = _Misfit.at(evidence)
    flexibility = [evidence.receptances.flexibility(one) for one in elements]
    # At a moving base an element changes nothing.
    elements = [one for one, size in zip(elements, flexibility, strict=True) if size > 0.0]
    units = [1.0 / max(size, _TINY) for size in flexibility if size > 0.0]
    starts = range(0, len(elements), MISSING_ELEMENT.chunk)
    chunks = [slice(start, start + MISSING_ELEMENT.chunk) for start in starts]
    gains = [misfit.compute_gains(elements[chunk], units[chunk]) for chunk in chunks]
    chosen = np.argsort(-np.concatenate([*gains, np.zeros(0)]))[: MISSING_ELEMENT.most_sized]
    found = [misfit.find_best_size(elements[i], units[i]) for i in chosen]
    found.sort(key=lambda one: one.squared_error)
    return [one.element for one in found[:most]]


@dataclass(frozen=True, slots=True, eq=False)
class _Misfit:
    """The weighted misfit at a point, from which changes of the model are subtracted."""

    evidence: Evidence
    e: ComplexArray

    @classmethod
    def at(cls, evidence: Evidence) -> Self:
        return cls(
            evidence, compute_log_misfit(evidence.model_response(evidence.frf), evidence.frf)[0]
        )

    def _project_changes(self, changes: Sequence[ComplexArray], prior: RealArray) -> RealArray:
        """Return the parts of weighted changes that unknowns cannot imitate, shape (2 m + n, k)."""
        columns = [
            np.concatenate([stack_real_imag(one) / self.evidence.rms_misfit, prior])
            for one in changes
        ]
        return self.evidence.project_out_unknowns(self.evidence.frf, np.stack(columns, axis=1))

    def residual(self, change: ComplexArray) -> RealArray:
        """Return the residual with a weighted change of the model, after all unknowns adapted."""
        return self._project_changes([self.e - change], self.evidence.offset_to_start)[:, 0]

    def _slopes(self, elements: Sequence[AddedElement]) -> RealArray:
        weight, R = self.evidence.weight, self.evidence.receptances
        zeros = np.zeros(len(self.evidence.offset_to_start))
        return self._project_changes([weight * R.slope(one) for one in elements], zeros)

    def compute_gains(self, elements: Sequence[AddedElement], units: Sequence[float]) -> RealArray:
        """Return the decrease of the sum of squares by each element, to first order from size 0."""
        D = self._slopes([replace(one, value=0.0) for one in elements]) * np.asarray(units)
        along = np.maximum(self.evidence.adapted_misfit @ D, 0.0)
        return np.asarray(along**2 / np.maximum(np.sum(D**2, axis=0), _TINY))

    def find_best_size(self, element: AddedElement, unit: float) -> _ScreenedElement:
        """Return the element with the trial size that leaves the least residual after a step."""
        sized = [replace(element, value=size * unit) for size in MISSING_ELEMENT.sizes]
        return min((self._screen_element(one) for one in sized), key=lambda one: one.squared_error)

    def _screen_element(self, element: AddedElement) -> _ScreenedElement:
        weight, R = self.evidence.weight, self.evidence.receptances
        b = self.evidence.adapted_misfit
        if element.value:
            b = self.residual(weight * R.log_change(element))
        d = self._slopes([element])[:, 0]
        step = float(d @ b) / max(float(d @ d), _TINY)
        low, high = 0.0, np.inf
        if element.value:
            low = -MISSING_ELEMENT.most_decrease * element.value
            high = MISSING_ELEMENT.most_increase * element.value
        b = b - float(np.clip(step, low, high)) * d
        return _ScreenedElement(element, float(b @ b))
