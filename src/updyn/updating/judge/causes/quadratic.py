"""Evidence of a hypothesis near a point, with the best-fitting spread of the held quantities.

Errors of many held quantities together can imitate a fault of the data; the evidence includes the
small probability of such a pattern. By Laplace's approximation it is the likelihood and prior
density at the best values times the Occam factor (MacKay, Neural Comput. 4 (1992) 415; Kass &
Raftery, J. Am. Stat. Assoc. 90 (1995) 773). The spread of held quantities maximises it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import BoolArray, NumberArray, RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import (
    Evidence,
    compute_spread,
    find_held,
    stack_real_imag,
)
from updyn.updating.judge.causes.misfit import add_perfect_fit
from updyn.updating.judge.causes.settings import HELD_QUANTITIES

__all__ = ["QuadraticMisfit", "QuadraticOutcome"]

_Complex = NDArray[np.complexfloating]


@dataclass(frozen=True, slots=True)
class QuadraticOutcome:
    """Mean square of the residual log misfit of a hypothesis, and log evidence up to a constant."""

    mean_square: float
    log_evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticMisfit:
    """The misfit at a point to second order, and the priors of the unknowns."""

    #: J^T J, shape (n, n), with real parts of J above imaginary parts.
    normal_matrix: RealArray
    #: J^T e, shape (n,).
    gradient: RealArray
    #: e^T e.
    squared_misfit: float
    #: Differences of the unknowns from the centres of their priors, shape (n,).
    offset: RealArray
    #: Standard deviations of the priors, shape (n,).
    spread: RealArray
    #: Whether an unknown is a held stiffness or mass, shape (n,).
    is_held: BoolArray
    #: Number of real values.
    n_values: int

    @classmethod
    def at_point(
        cls, evidence: Evidence, frf: FRF | None = None, slope: _Complex | None = None
    ) -> Self:
        """Return the quadratic approximation for model and data (corrected for a fault: `frf`).

        `slope` is the derivative of the log data by the size of a fault, then the last unknown.
        """
        part, J = evidence.part, evidence.jacobian
        e = evidence.misfit(evidence.frf if frf is None else frf)
        normal_matrix, gradient = evidence.normal_matrix, J.T @ e
        offset, spread, is_held = (
            evidence.x - part.coordinates.start,
            compute_spread(part),
            find_held(part),
        )
        if slope is not None:
            d = stack_real_imag(evidence.weight * slope)
            d /= max(float(np.sqrt(2.0 * d @ d / d.size)), np.finfo(np.float64).tiny)
            across = J.T @ d
            normal_matrix = np.block([[normal_matrix, across[:, None]], [across, d @ d]])
            gradient = np.append(gradient, d @ e)
            offset, spread, is_held = (
                np.append(offset, 0.0),
                np.append(spread, HELD_QUANTITIES.fault_std),
                np.append(is_held, False),
            )
        return cls(normal_matrix, gradient, float(e @ e), offset, spread, is_held, e.size)

    def find_best_share(
        self, count: float, level: float, least: float = 0.0
    ) -> tuple[float, QuadraticOutcome]:
        """Return the share of the spread with the largest evidence, and its outcome."""
        shares = HELD_QUANTITIES.std_shares[0 if self.is_held.any() else -1 :]
        found = [(share, self.evaluate_share(share, count, level, least)) for share in shares]
        return max(found, key=lambda one: one[1].log_evidence)

    def evaluate_share(
        self, share: float, count: float, level: float, least: float = 0.0
    ) -> QuadraticOutcome:
        """Return residual and evidence with a share of the spread of the held quantities.

        For a share of 1 the point is taken as the best one. `count` is the number of independent
        real values, `level` the mean square of the best hypothesis, taken as noise. `least` bounds
        the mean square below: the second order may predict any value at a poor end of a fit.
        """
        spread = np.where(self.is_held, share * self.spread, self.spread)
        # J^T J in units of the spread: the prior adds 1, so the system is well-posed.
        scaled = spread[:, None] * self.normal_matrix * spread
        curves, directions = np.linalg.eigh(scaled)
        step = np.zeros(len(spread))
        mean_square = self._mean_square(step)
        for _ in range(HELD_QUANTITIES.level_steps if share < 1.0 else 0):
            each = 2.0 * count / self.n_values / add_perfect_fit(mean_square)
            pull = directions.T @ (each * spread * self.gradient - self.offset / spread)
            step = spread * (directions @ (pull / (1.0 + each * np.maximum(curves, 0.0))))
            mean_square = max(self._mean_square(step), least)
        squared_distance = float(np.sum(((self.offset + step) / spread) ** 2))
        fitted = -0.5 * count * float(np.log(add_perfect_fit(mean_square))) - 0.5 * squared_distance
        # -ln of the share of the prior volume of held quantities that fits the data, for any values
        # of the other unknowns.
        each = 2.0 * count / self.n_values / add_perfect_fit(level)
        others = np.linalg.eigvalsh(scaled[np.ix_(~self.is_held, ~self.is_held)])
        occam = 0.5 * (_log_volume(each * curves) - _log_volume(each * others))
        return QuadraticOutcome(mean_square, fitted - occam)

    def _mean_square(self, step: RealArray) -> float:
        squared_misfit = (
            self.squared_misfit - 2.0 * self.gradient @ step + step @ self.normal_matrix @ step
        )
        return 2.0 * max(float(squared_misfit), 0.0) / self.n_values


def _log_volume(curves: NumberArray) -> float:
    """Return ln det(1 + A) from the eigenvalues of A; negative ones are rounding and count as 0."""
    return float(np.log1p(np.maximum(curves, 0.0)).sum())
