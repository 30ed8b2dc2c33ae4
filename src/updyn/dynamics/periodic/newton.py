"""Solutions of the harmonic balance at one frequency."""

from __future__ import annotations

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.periodic.balance import Evaluation, Residual
from updyn.dynamics.periodic.settings import BALANCE

__all__ = ["measure_amplitude", "solve_at"]


def measure_amplitude(x: RealArray) -> RealArray:
    """Return the amplitude of each element, (n_e, 1), above 0."""
    return np.maximum(np.linalg.norm(x, axis=1, keepdims=True), np.finfo(np.float64).tiny)


def solve_at(balance: Residual, x: RealArray, omega: float) -> Evaluation | None:
    """Return the solution at a frequency near x, by damped Newton iterations, or None."""
    now = balance.evaluate(x, omega)
    for _ in range(BALANCE.most_iterations):
        scale = measure_amplitude(now.x)
        size = float(np.max(np.abs(now.residual) / scale))
        if not np.isfinite(size):
            return None
        if size <= BALANCE.residual:
            return now
        try:
            step = np.linalg.solve(now.jacobian, -now.residual.ravel()).reshape(x.shape)
        except np.linalg.LinAlgError:
            return None
        norm = np.linalg.norm(now.residual / scale)
        for halving in range(BALANCE.most_halvings + 1):
            tried = balance.evaluate(now.x + 0.5**halving * step, omega)
            if np.linalg.norm(tried.residual / scale) < norm:
                break
        now = tried
    return None
