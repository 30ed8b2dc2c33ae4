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

from updyn.arrays import BoolArray, RealArray
from updyn.updating.judge.causes.evidence import Evidence, compute_spread, find_held
from updyn.updating.judge.causes.misfit import add_perfect_fit
from updyn.updating.judge.causes.settings import HELD_QUANTITIES

__all__ = ["QuadraticMisfit", "QuadraticOutcome"]


@dataclass(frozen=True, slots=True)
class QuadraticOutcome:
    """Mean square of the residual log misfit of a hypothesis, and log evidence up to a constant.

    Arrays of shape (k,) for k faults.
    """

    mean_square: RealArray
    log_evidence: RealArray


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticMisfit:
    """The misfit at a point to second order, and the priors of the unknowns.

    With k faults, each with its size as a further unknown, arrays begin with an axis of length k.
    """

    #: J^T J, shape (n, n), with real parts of J above imaginary parts.
    normal_matrix: RealArray
    #: J^T e, shape (n,) or (k, n).
    gradient: RealArray
    #: e^T e, a number or shape (k,).
    squared_misfit: RealArray | float
    #: Differences of the unknowns from the centres of their priors, shape (n,).
    offset: RealArray
    #: Standard deviations of the priors, shape (n,).
    spread: RealArray
    #: Whether an unknown is a held stiffness or mass, shape (n,).
    is_held: BoolArray
    #: Number of real values.
    n_values: int
    #: J^T d, d^T d and d^T e, with d the slope of the misfit by the size of a fault in units of its
    #: prior; zeros without a fault.
    slope: tuple[RealArray, RealArray | float, RealArray | float]

    @classmethod
    def at_point(
        cls,
        evidence: Evidence,
        gradient: RealArray,
        squared_misfit: RealArray | float,
        slope: tuple[RealArray, RealArray | float, RealArray | float] | None = None,
    ) -> Self:
        """Return the quadratic approximation; `slope` has J^T d, d^T d, d^T e in any unit."""
        part, n_values = evidence.part, len(evidence.jacobian)
        across, square, product = slope or (np.zeros_like(gradient), 0.0, 0.0)
        rms = np.sqrt(2.0 * np.asarray(square) / n_values)
        unit = HELD_QUANTITIES.fault_std / np.where(rms > 0.0, rms, 1.0)
        return cls(
            evidence.normal_matrix,
            gradient,
            squared_misfit,
            evidence.x - part.coordinates.start,
            compute_spread(part),
            find_held(part),
            n_values,
            (unit[..., None] * across, unit**2 * square, unit * product),
        )

    @property
    def std_shares(self) -> tuple[float, ...]:
        """Shares of the spread of the held quantities that are compared."""
        return HELD_QUANTITIES.std_shares[0 if self.is_held.any() else -1 :]

    def find_best_share(
        self, count: float, level: float, least: float = 0.0
    ) -> tuple[float, QuadraticOutcome]:
        """Return the share of the spread with the largest evidence, and its outcome; one fault."""
        found = [
            (share, self.evaluate_share(share, count, level, least)) for share in self.std_shares
        ]
        return max(found, key=lambda one: float(one[1].log_evidence))

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
        curves = np.maximum(curves, 0.0)  # negative ones are rounding
        gradient, offset = (
            (spread * self.gradient) @ directions,
            (self.offset / spread) @ directions,
        )
        across, square, product = self.slope
        across = spread * across
        along = across @ directions
        y, z = np.zeros_like(gradient), np.zeros(gradient.shape[:-1])

        def compute_mean_square() -> RealArray:
            linear = _sum_last(gradient * y) + product * z
            curved = _sum_last(curves * y**2) + z * (2.0 * _sum_last(along * y) + square * z)
            squared = self.squared_misfit - 2.0 * linear + curved
            return np.asarray(2.0 * np.maximum(squared, 0.0) / self.n_values)

        mean_square = compute_mean_square()
        for _ in range(HELD_QUANTITIES.level_steps if share < 1.0 else 0):
            each = 2.0 * count / self.n_values / add_perfect_fit(mean_square)
            pull = each[..., None] * gradient - offset
            # The size of the fault is eliminated.
            flexibility = 1.0 / (1.0 + each[..., None] * curves)
            coupling = flexibility * each[..., None] * along
            stiffness = _reduce_stiffness(each, curves, along, square)
            z = (each * product - _sum_last(coupling * pull)) / stiffness
            y = flexibility * pull - coupling * z[..., None]
            mean_square = np.maximum(compute_mean_square(), least)
        squared_distance = _sum_last((offset + y) ** 2) + z**2
        fitted = -0.5 * count * np.log(add_perfect_fit(mean_square)) - 0.5 * squared_distance
        # -ln of the share of the prior volume of held quantities that fits the data, for any values
        # of the other unknowns.
        each = 2.0 * count / self.n_values / add_perfect_fit(np.asarray(level))
        free = ~self.is_held
        other_curves, directions = np.linalg.eigh(scaled[np.ix_(free, free)])
        others = np.maximum(other_curves, 0.0), across[..., free] @ directions
        occam = _log_volume(each, curves, along, square) - _log_volume(each, *others, square)
        return QuadraticOutcome(mean_square, fitted - 0.5 * occam)


def _sum_last(values: RealArray) -> RealArray:
    return np.asarray(values.sum(axis=-1))


def _reduce_stiffness(
    each: RealArray, curves: RealArray, along: RealArray, square: RealArray | float
) -> RealArray:
    """Return 1 + `each` d^T d of a fault after all other unknowns have adapted, shape (k,)."""
    weight = each[..., None] ** 2 / (1.0 + each[..., None] * curves)
    return np.asarray(np.maximum(1.0 + each * square - _sum_last(weight * along**2), 1.0))


def _log_volume(
    each: RealArray, curves: RealArray, along: RealArray, square: RealArray | float
) -> RealArray:
    """Return ln det(1 + `each` A), with A the eigenvalues of J^T J, bordered by a fault."""
    stiffness = _reduce_stiffness(each, curves, along, square)
    return np.asarray(_sum_last(np.log1p(each[..., None] * curves)) + np.log(stiffness))
