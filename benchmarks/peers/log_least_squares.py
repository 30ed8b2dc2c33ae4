"""scipy.optimize.least_squares on log FRFs, with updyn's exact Jacobian: best of several starts.

What a user gets without a search and without a noise model: the trust region of scipy within the
bounds of the unknowns, from the given start and from others that are scattered about it as far as
the truth may be. Standard deviations are those of scipy's users, from the spread of the residual
and the Jacobian at the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.residuals import LogError

#: Largest loss factor of a scattered start.
DAMPED = 0.3
#: Evaluations of a start. No more were of use; scipy would allow 100 for each unknown.
EVALUATIONS = 300
TOLERANCE = 1e-10


@dataclass(frozen=True)
class Fitted:
    """Values and standard deviations by unknown, and how the best start ended."""

    values: dict[str, float]
    std: dict[str, float]
    ended: bool
    full_rank: bool
    evaluations: int


def fit(
    model: Model,
    frf: FRF,
    unknowns: ParameterSet,
    spread: Mapping[str, float],
    starts: int,
    rng: np.random.Generator,
) -> Fitted:
    """Return the best of the fits from the given start and from scattered ones."""
    part = FRFPart.build(model, frf, unknowns)
    found: list[OptimizeResult] = []
    used = 0
    for number in range(starts):
        values = unknowns.start if number == 0 else scattered(unknowns, spread, rng)
        outcome = descend(part, part.coordinates.to_x(values))
        if outcome is not None:
            found.append(outcome)
            used += outcome.nfev
    if not found:
        raise SolverError("least_squares: the model is singular at every start")
    best = min(found, key=lambda outcome: outcome.cost)
    values = part.coordinates.to_values(best.x)
    std, full_rank = deviations(best)
    std = std * part.coordinates.slope(best.x)
    return Fitted(
        dict(zip(unknowns.names, values.tolist(), strict=True)),
        dict(zip(unknowns.names, std.tolist(), strict=True)),
        best.status > 0,
        full_rank,
        used,
    )


def scattered(
    unknowns: ParameterSet, spread: Mapping[str, float], rng: np.random.Generator
) -> np.ndarray:
    """Return values of the unknowns about their start, as far off as the truth may be."""
    values = []
    for p in unknowns:
        if p.quantity == "loss_factor":
            values.append(rng.uniform(0.0, DAMPED))
        else:
            values.append(p.start * (1.0 + rng.uniform(-1.0, 1.0) * spread.get(p.quantity, 0.0)))
    return np.clip(values, unknowns.lower, unknowns.upper)


def descend(part: FRFPart, x: np.ndarray) -> OptimizeResult | None:
    """Return where scipy's trust region ends, or None where the model cannot be solved."""

    @lru_cache(maxsize=2)
    def evaluated(at: bytes) -> tuple[np.ndarray, np.ndarray]:
        r, J = [], []
        for lines in part.partition():
            own, derivatives = LogError().block(part, np.frombuffer(at), lines)
            r.append(own.ravel())
            J.append(derivatives.reshape(len(derivatives), -1))
        residual, jacobian = np.concatenate(r), np.concatenate(J, axis=1).T
        return (
            np.concatenate([residual.real, residual.imag]),
            np.concatenate([jacobian.real, jacobian.imag]),
        )

    try:
        return least_squares(
            lambda at: evaluated(at.tobytes())[0],
            x,
            jac=lambda at: evaluated(at.tobytes())[1],
            bounds=part.coordinates.bounds,
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            max_nfev=EVALUATIONS,
        )
    except SolverError:
        return None


def deviations(best: OptimizeResult) -> tuple[np.ndarray, bool]:
    """Return the standard deviations in x, inf without full rank, and whether there is."""
    m, n = best.jac.shape
    scale = np.linalg.norm(best.jac, axis=0)
    if not (scale > 0).all():
        return np.full(n, np.inf), False
    R = np.linalg.qr(best.jac / scale, mode="r")
    if np.linalg.matrix_rank(R) < n:
        return np.full(n, np.inf), False
    half = np.linalg.solve(R.T, np.eye(n)) / scale
    return np.sqrt(2.0 * best.cost / (m - n)) * np.linalg.norm(half, axis=0), True
