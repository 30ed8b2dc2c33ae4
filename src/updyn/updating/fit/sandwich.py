"""Standard deviations of a fit whose weights are not those of the noise: the sandwich covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from updyn.updating.fit.method import known_length, spread_of
from updyn.updating.fit.trust_region import Local
from updyn.updating.judge.identifiability import RANK_TOLERANCE
from updyn.updating.problem.joint import Task
from updyn.updating.problem.noise import Estimated, NoiseModel, Robust
from updyn.updating.problem.residuals import Each, LogError, OutputError

__all__ = ["Sandwich", "sandwich"]

_Matrix = NDArray[np.float64]
#: Directions that the data hardly see keep the Jacobian's own length, beyond this share of what
#: rounding leaves.
_CLEAR = 10.0 * RANK_TOLERANCE
#: Noise over |H| from which the logarithm of a value is off by its curvature; the share of such
#: values worth a word.
_LOUD, _MANY = 0.5, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Sandwich:
    """What is known of a fit of fixed weights under noise that has others.

    Attributes
    ----------
    R : ndarray of float, shape (k, n)
        R^T R is the inverse covariance of the unknowns.
    noise : tuple of dict
        For the record, for each part of the problem.
    note : str
        Where the noise is too large for the residual; may be empty.
    """

    R: _Matrix
    noise: tuple[dict[str, Any], ...]
    note: str = ""


def sandwich(
    problem: Task,
    residual: LogError | Each,
    local: Local,
    x: NDArray[np.float64],
    noises: Sequence[NoiseModel] = (),
) -> Sandwich | None:
    """Return the covariance of a fit, or None where there is none or the user does not wait for it.

    With A = J^T J of the weighted Jacobian J, and S the covariance of the weighted residual, the
    estimate has the covariance A^-1 (J^T S J) A^-1 (Huber, Proc. 5th Berkeley Symp. 1 (1967) 221;
    White, Econometrica 48 (1980) 817). S is that of the noise model, not squares of the residuals
    themselves: these are too few where single peaks carry a fit (`benchmarks/sandwich.py`). Where
    the weighted misfit exceeds what S explains, S grows to it, and by the lines over which the
    residual is correlated.

    Parameters
    ----------
    problem : Task
        What was fitted.
    residual : LogError or Each
        Its residual.
    local : Local
        The reduced problem at `x`, with its own weights.
    x : ndarray of float, shape (n,)
        The estimate.
    noises : sequence of NoiseModel
        How uncertain the data of each part are; estimated from the residual where none are given.

    Raises
    ------
    Stopped
        If the user wants to stop.
    """
    try:
        return _sandwich(problem, residual, local, x, noises or [Estimated()] * len(problem.parts))
    except LinAlgError:
        return None


def _sandwich(
    problem: Task,
    residual: LogError | Each,
    local: Local,
    x: NDArray[np.float64],
    noises: Sequence[NoiseModel],
) -> Sandwich | None:
    looked, weights, spreads, total, loud = [], [], [], 0.0, []
    for i, (part, given) in enumerate(zip(problem.parts, noises, strict=True)):
        H, frf = part.responses(x), part.frf
        noise = (
            given.base if isinstance(given, Robust) else given
        )  # its weights are not those of this fit
        noise = noise.refit(H, frf, -(-problem.n * part.n_values // problem.n_values))
        variance = noise.variance(H, frf)
        size = np.abs(H)
        seen = (size > 0.0) & (frf.values != 0.0)
        safe = np.where(seen, size, 1.0)
        weight = (
            np.where(seen, 1.0 / safe, 0.0)
            if isinstance(residual, LogError)
            else residual.of(i).weight
        )
        total += float(np.sum(weight**2 * variance))
        looked.append(noise)
        weights.append(weight)
        spreads.append(OutputError(weight**2 * np.sqrt(0.5 * variance), "spread"))
        loud.append(np.mean(np.sqrt(variance) > _LOUD * safe))
    meat = Each(tuple(spreads)).local(problem, x)
    if meat is None or total == 0.0:
        return None
    norms = np.linalg.norm(local.R, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    _, s, Vt = np.linalg.svd(local.R / scale)
    clear = s > _CLEAR * max(s[0], np.finfo(float).tiny)
    along = (
        (meat.R / scale) @ Vt[clear].T / s[clear]
    )  # its square: J^T S J where J has unit directions
    expected = total - float(np.sum(along**2))
    misfit = 2.0 * local.cost / expected if expected > 1e-3 * total else 1.0
    known = known_length(problem, x, lambda i, H: weights[i] * (H - problem.parts[i].frf.values))
    told = max(misfit, 1.0) if all(noise.scale_known for noise in looked) else misfit
    inflation = float(np.sqrt(told * known.get("correlation_length", 1.0)))
    factor = inflation * cholesky(along.T @ along, lower=True)
    rows = solve_triangular(factor, s[clear, None] * Vt[clear], lower=True)
    usual = inflation * np.sqrt(total / (2.0 * problem.n_values))
    R = np.vstack([rows, s[~clear, None] * Vt[~clear] / usual]) * scale
    taken = looked[0].kind.startswith("estimated")  # from this very residual
    spread = float(np.sqrt(2.0) * spread_of(local, problem.n_values, problem.n))
    record = {
        "chi_square": 1.0 if taken else float(misfit),
        "spread": spread,
        **known,
        "inflation": inflation,
    }
    return Sandwich(
        R, tuple({"kind": n.kind, **n.figures(), **record} for n in looked), _note(residual, loud)
    )


def _note(residual: LogError | Each, loud: Sequence[Any]) -> str:
    share = float(np.max(loud))
    if not isinstance(residual, LogError) or share <= _MANY:
        return ""
    return (
        f"In {100.0 * share:.0f} % of the values the noise is above half of |H|: their logarithm is"
        " biased, and the standard deviations do not show it; maximum-likelihood weighs them"
        " rightly."
    )
