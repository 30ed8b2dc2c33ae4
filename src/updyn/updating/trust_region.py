"""Nonlinear least squares with bounds: a trust region on the reduced Jacobian.

The problem is met only through its reduced form at a point: the triangle R of the QR factors of the stacked, weighted
Jacobian and the projected residual. A step minimises |R p + q| within a ball, on the unknowns that no bound holds.
The normal equations are never formed (More 1978, "The Levenberg-Marquardt algorithm"; Nocedal & Wright 2006, chapters 4
and 10).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Local", "Outcome", "Step", "TrustRegion"]

_Vector = NDArray[np.float64]

_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """The least-squares problem at one point.

    Attributes
    ----------
    cost : float
        Half the sum of squared residuals.
    R : ndarray of float, shape (k, n)
        Reduced Jacobian, k <= n.
    q : ndarray of float, shape (k,)
        Reduced residual: the gradient is R^T q.
    """

    cost: float
    R: NDArray[np.float64]
    q: _Vector

    @property
    def gradient(self) -> _Vector:
        """Gradient of the cost, shape (n,)."""
        return np.asarray(self.R.T @ self.q)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One trial step, as shown to the observer.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        The point after it (the trial, whether accepted or not).
    local : Local or None
        The problem there; None where it could not be evaluated.
    length : float
        Largest component of the step.
    accepted : bool
        Whether it was taken.
    """

    x: _Vector
    local: Local | None
    length: float
    accepted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Where the iteration ended.

    Attributes
    ----------
    x : ndarray of float, shape (n,)
        Best point.
    local : Local
        The problem there.
    reason : {"converged", "stalled", "max-iterations", "stopped"}
        Why it ended.
    """

    x: _Vector
    local: Local
    reason: str


@dataclass(frozen=True, slots=True)
class TrustRegion:
    """Settings of the iteration.

    Parameters
    ----------
    max_iterations : int
        Largest number of trial steps.
    tolerance : float
        Converged when a step and the predicted fall of the cost are below this, relative.
    radius : float
        First radius, in the units of x (logarithms of factors: 0.5 is about 65 %).
    fall, relative_fall : float
        Converged, too, when the linear model promises no larger fall of the cost, absolute or as a share of it.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    radius: float = 0.5
    fall: float = 0.0
    relative_fall: float = 0.0

    @property
    def _share(self) -> float:
        return max(self.tolerance**2, self.relative_fall)

    def minimise(
        self,
        evaluate: Callable[[_Vector], Local | None],
        x: _Vector,
        lower: _Vector,
        upper: _Vector,
        observe: Callable[[Step], bool] | None = None,
    ) -> Outcome:
        """Minimise from `x` within the bounds.

        Parameters
        ----------
        evaluate : callable
            Returns the local problem at a point, or None where the model cannot be solved.
        x, lower, upper : ndarray of float, shape (n,)
            Start, which must be possible to evaluate, and bounds.
        observe : callable, optional
            Called after every trial step; returning True stops the iteration.

        Returns
        -------
        Outcome
        """
        here = evaluate(x)
        if here is None:
            raise ArithmeticError("the start cannot be evaluated")
        radius = self.radius
        for _ in range(self.max_iterations):
            p, fall = _step(here, x, lower, upper, radius)
            length = float(np.abs(p).max(initial=0.0))
            if length == 0.0 or fall <= max(self.fall, self._share * here.cost):
                return Outcome(x, here, "converged")
            trial = np.clip(x + p, lower, upper)
            there = evaluate(trial)
            gain = -1.0 if there is None or not np.isfinite(there.cost) else (here.cost - there.cost) / fall
            accepted = gain > 1e-4
            stop = observe is not None and observe(Step(trial, there, length, accepted))
            size = float(np.linalg.norm(p))
            if accepted and there is not None:
                small = length <= self.tolerance or here.cost - there.cost <= self._share * here.cost
                x, here = trial, there
                radius = max(radius, 2.0 * size) if gain > 0.75 else radius if gain > 0.25 else 0.5 * size
                if small and gain > 0.25:
                    return Outcome(x, here, "converged")
            else:
                # A whole Gauss-Newton step this small that still does not help: only rounding is left.
                if length <= _ROUNDING and size < 0.99 * radius:
                    return Outcome(x, here, "converged")
                radius = 0.25 * size
                if length <= self.tolerance:
                    return Outcome(x, here, "converged" if fall <= 1e-6 * here.cost else "stalled")
            if stop:
                return Outcome(x, here, "stopped")
        return Outcome(x, here, "max-iterations")


def _step(here: Local, x: _Vector, lower: _Vector, upper: _Vector, radius: float) -> tuple[_Vector, float]:
    """Return the step and the fall of the cost that the linear model predicts."""
    g = here.gradient
    free = ~(((x <= lower) & (g > 0)) | ((x >= upper) & (g < 0)))
    p = np.zeros(len(x))
    for _ in range(len(x) + 1):
        q = here.q + here.R[:, ~free] @ p[~free]
        p[free] = _ball_step(here.R[:, free], q, radius)
        over = free & ((x + p < lower) | (x + p > upper))
        if not over.any():
            break
        # Unknowns that would leave their bounds are put on them, and the others are solved for again.
        p[over] = np.clip(x + p, lower, upper)[over] - x[over]
        free = free & ~over
    moved = here.R @ p
    return p, float(-(moved @ here.q) - 0.5 * (moved @ moved))


def _ball_step(R: NDArray[np.float64], q: _Vector, radius: float) -> _Vector:
    """Minimise |R p + q| subject to |p| <= radius, by the singular value decomposition of R."""
    if R.shape[1] == 0:
        return np.zeros(0)
    norms = np.linalg.norm(R, axis=0)
    weight = np.where(norms > 0, norms, 1.0)
    U, s, Vt = np.linalg.svd(R / weight, full_matrices=False)
    keep = s > s[0] * max(R.shape) * np.finfo(float).eps if s.size else s > 0
    full = -(Vt[keep].T @ ((U.T @ q)[keep] / s[keep])) / weight
    if np.linalg.norm(full) <= radius:
        return np.asarray(full)
    U, s, Vt = np.linalg.svd(R, full_matrices=False)
    b = U.T @ q
    # |p(damping)| falls monotonically: bisect, in the logarithm, the damping that puts p on the sphere.
    high = max(float(np.linalg.norm(s * b)) / radius, np.finfo(float).tiny)
    low = high * 1e-40
    while high > 1.05 * low:
        middle = np.sqrt(low) * np.sqrt(high)
        if np.linalg.norm(s * b / (s**2 + middle)) > radius:
            low = middle
        else:
            high = middle
    return np.asarray(-(Vt.T @ (s * b / (s**2 + high))))
