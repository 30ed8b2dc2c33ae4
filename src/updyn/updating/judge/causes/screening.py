"""Selection of the elements that a model may lack, by their effect to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import RealArray
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
        basis = np.ascontiguousarray(evidence.orthonormal_basis[0].T)
        imitated = sum(multiply(v) ** 2 for v in basis)
        size = vectors.sum_squares(c, MISSING_ELEMENT.chunk)
        least = CAUSE_MISFIT.dependent_share**2 * size + _TINY
        return np.asarray(along**2 / np.maximum(size - imitated, least))

    def find_best_size(self, element: AddedElement, unit: float) -> _ScreenedElement:
        """Return the element with the trial size that leaves the least residual after a step."""
        # With P the projection by which the unknowns adapt and b the adapted misfit, P b = b, the
        # residual of a change c and a step t of the slope d is b - P c - t P d.
        evidence = self.evidence
        sizes = np.array(MISSING_ELEMENT.sizes) * unit
        effect = evidence.receptances.find_effect(element)
        changes, slopes = zip(*(effect.evaluate(size) for size in sizes.tolist()), strict=True)
        weighted = [stack_real_imag(evidence.weight * one) for one in (*slopes, *changes)]
        V, b = np.array(weighted) / evidence.rms_misfit, evidence.adapted_misfit
        n = V.shape[1]
        along_basis, along_b = V @ evidence.orthonormal_basis[0][:n], V @ b[:n]
        gram = V @ V.T - along_basis @ along_basis.T
        k = len(sizes)
        d_d, d_c, c_c = (np.diag(one) for one in (gram[:k, :k], gram[:k, k:], gram[k:, k:]))
        along = along_b[:k] - d_c
        step = np.clip(along / np.maximum(d_d, _TINY), *self._limit_step(sizes))
        squared = b @ b - 2.0 * along_b[k:] + c_c - 2.0 * step * along + step**2 * d_d
        best = int(np.argmin(squared))
        chosen = replace(element, value=float(sizes[best]))
        return _ScreenedElement(chosen, float(squared[best]))

    @staticmethod
    def _limit_step(sizes: RealArray) -> tuple[RealArray, RealArray]:
        """Return the least and the largest change of each size."""
        highest = np.where(sizes > 0.0, MISSING_ELEMENT.most_increase * sizes, np.inf)
        return -MISSING_ELEMENT.most_decrease * sizes, highest
