"""Values of data between DOFs that have both a sensor and a force."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.misfit import remove_weight
from updyn.updating.problem.noise.neighbours import estimate_scatter

__all__ = ["CollocatedFrfs"]


@dataclass(frozen=True, slots=True, eq=False)
class CollocatedFrfs:
    """Values (n_f, n, n) between unsigned DOFs that have both a sensor and a force.

    `rows` and `columns` are positions among responses and references; `noise` is the larger of the
    known standard deviation and the scatter of neighbouring lines; `freq` is in Hz, `s` in 1/s.
    """

    labels: tuple[str, ...]
    rows: IndexArray
    columns: IndexArray
    values: ComplexArray
    noise: RealArray
    freq: RealArray
    s: ComplexArray
    quantity: str

    @classmethod
    def of(cls, frf: FRF) -> CollocatedFrfs:
        """Return the values of data."""
        responses = {str(abs(dof)): i for i, dof in enumerate(frf.responses)}
        references = {str(abs(dof)): j for j, dof in enumerate(frf.references)}
        labels = tuple(label for label in references if label in responses)
        rows = np.array([responses[label] for label in labels], dtype=np.intp)
        columns = np.array([references[label] for label in labels], dtype=np.intp)
        sign = np.multiply.outer(frf.responses.signs[rows], frf.references.signs[columns])
        at = np.ix_(np.arange(len(frf.freq)), rows, columns)
        variance = estimate_scatter(frf)[at]
        if frf.variance is not None:
            variance = np.maximum(variance, frf.variance[at])
        values, noise = frf.values[at] * sign, np.sqrt(variance)
        return cls(labels, rows, columns, values, noise, frf.freq, frf.s, frf.quantity)

    def iter_pairs(self) -> Iterator[tuple[int, int]]:
        """Yield the pairs of different DOFs."""
        yield from combinations(range(len(self.labels)), 2)

    def mask_pairs(self, frf: FRF, pairs: Iterable[tuple[int, int]]) -> FRF:
        """Return the data with no weight on some pairs of response and force, as positions."""
        mask = np.zeros(frf.values.shape[1:], dtype=np.bool_)
        for i, j in pairs:
            mask[self.rows[i], self.columns[j]] = True
        return remove_weight(frf, mask)
