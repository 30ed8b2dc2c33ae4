"""The residual of a finished fit, test by test: whitened by its noise, tested, and what would explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.judge.adequacy import LEVEL, Adequacy, assess, blamed
from updyn.updating.judge.localise import localise
from updyn.updating.problem.joint import Task
from updyn.updating.problem.noise import NoiseModel, Robust
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Each, OutputError

__all__ = ["examine"]

#: A fit whose unknowns could still take away more than this share of what is left is on its way.
_MOVING = 0.05


def examine(
    problem: Task, x: NDArray[np.float64], noises: Sequence[NoiseModel], *, settled: bool = True
) -> tuple[Adequacy | None, ...]:
    """Test whether what a fit leaves is noise, at the lines of the fit, by the noise models of its tests.

    Whatever residual a method has minimised, measured minus computed FRF is looked at. Values that
    a robust fit gave less weight count in full. To find what would explain a misfit takes one
    evaluation with derivatives.

    Parameters
    ----------
    problem : Task
        What was fitted.
    x : ndarray of float, shape (n,)
        The estimate.
    noises : sequence of NoiseModel
        How uncertain the data of each part are.
    settled : bool
        Whether the fit ended at a minimum. Where it did not, it is looked at all the same if the
        unknowns could not take away more than a twentieth of what is left.

    Returns
    -------
    tuple of Adequacy or None
        For each part; None where the model cannot be solved, or the fit was still on its way.
    """
    try:
        answers = [part.responses(x) for part in problem.parts]
    except SolverError:
        return (None,) * len(problem.parts)
    found, errors, whitened = [], [], []
    for part, noise, H in zip(problem.parts, noises, answers, strict=True):
        share = -(-problem.n * part.n_values // problem.n_values)
        weight = _weight(noise, H, part, share)
        errors.append(OutputError(weight, "residual"))
        with np.errstate(invalid="ignore"):
            misfit = part.frf.values - H
            whitened.append(np.where(weight > 0.0, weight * misfit, np.nan))
        base = noise.base if isinstance(noise, Robust) else noise
        absolute = base.scale_known and not base.kind.startswith(("estimated", "assumed"))
        found.append(
            assess(
                whitened[-1],
                H,
                part.frf.freq,
                part.frf.responses.labels,
                part.frf.references.labels,
                n_unknowns=share,
                absolute=absolute,
                averages=part.frf.averages if base.kind != "stated" else None,
                level=LEVEL / len(problem.parts),
                relative=_relative(misfit, part),
            )
        )
    residual = Each(tuple(errors))
    if not settled and _moves(problem, residual, x):
        return (None,) * len(problem.parts)
    if all(a.outcome not in ("structure", "excess") for a in found):
        return tuple(found)
    beyond = None
    if all(a.absolute for a in found):
        beyond = (
            sum(float(np.nansum(np.abs(e) ** 2)) - 2.0 * np.isfinite(e).sum() for e in whitened)
            + problem.n
        )
    suspects = localise(problem, x, residual, whitened, beyond)
    return tuple(blamed(a, suspects) for a in found)


def _moves(problem: Task, residual: Each, x: NDArray[np.float64]) -> bool:
    """Return whether the unknowns could still take away a good part of what is left."""
    local = residual.local(problem, x)
    return local is None or float(local.q @ local.q) > _MOVING * 2.0 * local.cost


def _weight(
    noise: NoiseModel, H: NDArray[np.complex128], part: Problem, share: int
) -> NDArray[np.float64]:
    """Return 1 / sigma of the real and of the imaginary part; 0 for what has no finite variance."""
    known = noise.refit(H, part.frf, share)
    plain = replace(known, weight=None) if isinstance(known, Robust) else known
    variance = np.broadcast_to(plain.variance(H, part.frf), H.shape)
    usable = np.isfinite(variance) & (variance > 0.0)
    return np.where(usable, np.sqrt(2.0 / np.where(usable, variance, 1.0)), 0.0)


def _relative(misfit: NDArray[np.complex128], part: Problem) -> float:
    """Return the largest rms misfit of a channel over the rms of its data."""
    left, size = (np.sqrt(np.mean(np.abs(a) ** 2, axis=0)) for a in (misfit, part.frf.values))
    return float(np.max(left / np.where(size > 0.0, size, 1.0)))
