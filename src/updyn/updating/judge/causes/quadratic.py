"""Evidence of a hypothesis near a point, with the best-fitting spread of the held quantities.

Held quantities of a model may be off by 5 %, and many of them together can imitate a fault of the
data, such as a scaled frequency axis. A comparison of the best fits ignores how improbable this is:
independent errors of 5 % each hardly ever form the pattern of a fault to the precision of the data.
The evidence includes this probability. By Laplace's approximation it is the likelihood and the
prior density at the best values, times the share of the prior volume that is compatible with the
data (Occam factor: MacKay, Neural Comput. 4 (1992) 415; Kass & Raftery, J. Am. Stat. Assoc. 90
(1995) 773). The size of the errors of held quantities is unknown; for each hypothesis the size with
the largest evidence is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import (
    PERFECT_FIT,
    Evidence,
    compute_spread,
    find_held,
    stack_real_imag,
)

__all__ = ["SHARES", "Outcome", "Quadratic"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complexfloating[Any, Any]]

#: Possible errors of held quantities, as shares of their prior standard deviation.
SHARES = (0.02, 0.1, 0.3, 1.0)
#: Prior standard deviation of the log misfit (rms) due to a fault; so large that it has no effect.
_OPEN = 10.0
#: Number of iterations for the level of the residual.
_LEVELS = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """A hypothesis for one share of the spread of the held quantities.

    Attributes
    ----------
    power : float
        Mean square of the residual log misfit.
    log_evidence : float
        Logarithm of the evidence, up to a constant.
    """

    power: float
    log_evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Quadratic:
    """The misfit at a point to second order, and the priors of the unknowns.

    Attributes
    ----------
    normal : ndarray of float, shape (n, n)
        J^T J, with real parts of J above imaginary parts.
    gradient : ndarray of float, shape (n,)
        J^T e.
    square : float
        e^T e.
    off : ndarray of float, shape (n,)
        Differences of the unknowns from the centres of their priors.
    spread : ndarray of float, shape (n,)
        Standard deviations of the priors.
    held : ndarray of bool, shape (n,)
        Whether an unknown is a held stiffness or mass.
    n_values : int
        Number of real values.
    """

    normal_matrix: _Real
    gradient: _Real
    square: float
    off: _Real
    spread: _Real
    held: NDArray[np.bool_]
    n_values: int

    @classmethod
    def at(cls, evidence: Evidence, frf: FRF | None = None, slope: _Complex | None = None) -> Self:
        """Return the quadratic approximation for model and data at a point.

        `frf` are the data corrected for a fault, by default those of the evidence. `slope`, shape
        (n_f, n_i, n_j), is the derivative of the log data by the size of a fault, which is then the
        last unknown.
        """
        part, J = evidence.part, evidence.jacobian
        e = evidence.misfit(evidence.frf if frf is None else frf)
        normal, gradient = evidence.normal_matrix, J.T @ e
        off, spread, held = (
            evidence.x - part.coordinates.home,
            compute_spread(part),
            find_held(part),
        )
        if slope is not None:
            d = stack_real_imag(evidence.weight * slope)
            d /= max(float(np.sqrt(2.0 * d @ d / d.size)), np.finfo(np.float64).tiny)
            across = J.T @ d
            normal = np.block([[normal, across[:, None]], [across, d @ d]])
            gradient = np.append(gradient, d @ e)
            off, spread, held = (
                np.append(off, 0.0),
                np.append(spread, _OPEN),
                np.append(held, False),
            )
        return cls(normal, gradient, float(e @ e), off, spread, held, e.size)

    def best(self, count: float, level: float, least: float = 0.0) -> tuple[float, Outcome]:
        """Return the share of the spread with the largest evidence, and its outcome."""
        shares = SHARES if self.held.any() else SHARES[-1:]
        found = [(share, self.outcome(share, count, level, least)) for share in shares]
        return max(found, key=lambda one: one[1].log_evidence)

    def outcome(self, share: float, count: float, level: float, least: float = 0.0) -> Outcome:
        """Return residual and evidence with a share of the spread of the held quantities.

        For a share of 1 the point is taken as the best one. `count` is the number of independent
        real values, `level` the mean square of the log misfit of the best hypothesis, taken as
        noise. `least` is a lower bound of the mean square, because the second order may predict any
        value at a poor end of a fit.
        """
        spread = np.where(self.held, share * self.spread, self.spread)
        # J^T J in units of the spread: the prior adds 1, so the system is well-posed.
        scaled = spread[:, None] * self.normal_matrix * spread
        curves, directions = np.linalg.eigh(scaled)
        step = np.zeros(len(spread))
        power = self._power(step)
        for _ in range(_LEVELS if share < 1.0 else 0):
            each = 2.0 * count / self.n_values / (power + PERFECT_FIT**2)
            pull = directions.T @ (each * spread * self.gradient - self.off / spread)
            step = spread * (directions @ (pull / (1.0 + each * np.maximum(curves, 0.0))))
            power = max(self._power(step), least)
        far = float(np.sum(((self.off + step) / spread) ** 2))
        fitted = -0.5 * count * float(np.log(power + PERFECT_FIT**2)) - 0.5 * far
        # -ln of the share of the prior volume of held quantities that fits the data, for any values
        # of the other unknowns.
        each = 2.0 * count / self.n_values / (level + PERFECT_FIT**2)
        others = np.linalg.eigvalsh(scaled[np.ix_(~self.held, ~self.held)])
        occam = 0.5 * (_log_volume(each * curves) - _log_volume(each * others))
        return Outcome(power, fitted - occam)

    def _power(self, step: _Real) -> float:
        left = self.square - 2.0 * self.gradient @ step + step @ self.normal_matrix @ step
        return 2.0 * max(float(left), 0.0) / self.n_values


def _log_volume(curves: NDArray[Any]) -> float:
    """Return ln det(1 + A) from the eigenvalues of A; negative ones are rounding and count as 0."""
    return float(np.log1p(np.maximum(curves, 0.0)).sum())
