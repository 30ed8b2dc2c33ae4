"""Rounding errors of the model's responses, which limit the accuracy of a fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.fields import EXACT_TIERS
from updyn.errors import SolverError
from updyn.frf import TRANSMISSIBILITY
from updyn.updating.judge.settings import EFFORT, ROUNDING_CHECK, SIGNIFICANCE
from updyn.updating.problem.problem import FRFPart

__all__ = ["REMEDY", "Rounding", "find_worst_rounding"]


#: Remedy for rounding errors.
REMEDY = (
    "Leave out such channels and lines; or condense the model, coarsen its mesh, or merge parts"
    " that are far stiffer than the others."
)


@dataclass(frozen=True, slots=True)
class Rounding:
    """Rounding error of a response at `freq` (Hz) that is not small compared with the misfit."""

    share: float
    freq: float
    response: str
    reference: str
    test: str = ""

    @property
    def message(self) -> str:
        """Description of the error in two sentences."""
        at = f"{self.response} / {self.reference}" + (
            f" of test {self.test!r}" if self.test else ""
        )
        return (
            f"The model's response for {at} is only accurate to {100 * self.share:.2g} % at"
            f" {self.freq:.4g} Hz: rounding in double precision is significant if stiffnesses"
            " differ much in size, or if a motion nearly cancels. No fit can be more accurate."
        )


def find_worst_rounding(parts: Iterable[FRFPart], x: RealArray) -> Rounding | None:
    """Return the largest rounding error of the model's responses; None if negligible."""
    # A few lines are solved with Z and with 3 Z, whose entries are rounded differently; the
    # difference is a sample of the forward error, which the backward error does not show (Higham,
    # Accuracy and Stability of Numerical Algorithms (2002), section 1.6). Reduced models are not
    # checked: their error is bounded separately.
    found = []
    for part in parts:
        if part.solver.tier not in EXACT_TIERS:
            continue
        at = np.unique(np.linspace(0, part.n_lines - 1, _n_checked_lines(part)).astype(int))
        measured = np.abs(part.frf.values)
        try:
            share = _relative_rounding(part, x, part.frf.freq[at])
            residual = np.abs(part.responses(x) - part.frf.values)
        except SolverError:
            continue
        misfit = np.median(residual / np.where(measured > 0.0, measured, np.inf), axis=0)
        is_relevant = (
            (share > ROUNDING_CHECK.negligible_share)
            & (share > SIGNIFICANCE.negligible_error * misfit)
            & (part.sign != 0.0)
        )
        share = np.where(is_relevant, share, 0.0)
        i, j, k = (int(n) for n in np.unravel_index(np.argmax(share), share.shape))
        if share[i, j, k] > 0.0:
            channel = (part.frf.responses.labels[j], part.frf.references.labels[k])
            found.append(
                Rounding(float(share[i, j, k]), float(part.frf.freq[at[i]]), *channel, part.name)
            )
    return max(found, key=lambda r: r.share, default=None)


def _n_checked_lines(part: FRFPart) -> int:
    """Return the number of lines to check; each takes two solutions."""
    n = part.solver.system.n
    if n > EFFORT.most_dofs:
        return 1
    if n <= EFFORT.small_model_dofs:
        return ROUNDING_CHECK.lines
    return int(np.clip(part.n_lines // ROUNDING_CHECK.lines_per_check, 1, ROUNDING_CHECK.lines))


def _relative_rounding(part: FRFPart, x: RealArray, freq: RealArray) -> RealArray:
    """Return the relative rounding error at some lines, shape (n_f, n_i, n_j)."""
    solver, system = part.solver, part.solver.system
    Z = system.coefficients(part.unknowns.state(system, part.values(x)), 2.0 * np.pi * freq)
    columns, place = np.unique(part.columns, return_inverse=True)
    X, Y = (
        solver.at(solver.solve(times * Z, columns, freq), part.rows)[..., place]
        for times in (1.0, 3.0)
    )
    size = np.abs(X)
    if part.frf.quantity != TRANSMISSIBILITY:  # a ratio of motions does not change with Z
        Y = 3.0 * Y
    # A response that is exactly zero has no rounding error.
    return np.asarray(np.abs(Y - X) / np.where(size > 0.0, size, np.inf)).transpose(1, 0, 2)
