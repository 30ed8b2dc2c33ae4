"""Rounding errors of the model's answers, which limit any fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import EXACT_TIERS
from updyn.errors import SolverError
from updyn.updating.problem.problem import Part

__all__ = ["REMEDY", "Rounding", "worst_rounding"]

#: Lines that are looked at: of a model of more than so many DOFs one in twenty at most, and of one
#: of more than so many the lowest alone.
_LINES, _LARGE, _SHARE, _MANY = 3, 400, 20, 20_000
#: Shares of an answer, and of the channel's misfit, below which rounding is of no concern.
_FINE, _SMALL = 1e-6, 0.1

#: What to do about it.
REMEDY = (
    "Leave out such channels and lines; or condense the model, coarsen its mesh, merge what is far"
    " stiffer."
)


@dataclass(frozen=True, slots=True)
class Rounding:
    """Where rounding moves the model's answer by what matters beside the misfit.

    Attributes
    ----------
    share : float
        Of the answer.
    freq : float
        In Hz.
    response, reference : str
        The channel.
    test : str
        Which test, where there are several.
    """

    share: float
    freq: float
    response: str
    reference: str
    test: str = ""

    @property
    def message(self) -> str:
        """What it means, in words."""
        at = f"{self.response} (force {self.reference})" + (
            f" of test {self.test!r}" if self.test else ""
        )
        return (
            f"The model's own answer for {at} is only certain to {100 * self.share:.2g} % at"
            f" {self.freq:.4g} Hz: rounding in double precision is seen where stiffnesses differ"
            " much in size, or where a motion all but cancels. No fit can go below that."
        )


def worst_rounding(parts: Iterable[Part], x: NDArray[np.float64]) -> Rounding | None:
    """Look for lines at which the answer of a model is moved by rounding more than a fit can bear.

    A few lines are solved twice: with Z, and with 3 Z, whose entries are all rounded anew. What the
    answers differ by is a sample of the forward error, which a backward error (that of a stable
    solver is always small) does not show: Higham, Accuracy and Stability of Numerical Algorithms
    (2002), section 1.6. Reduced models are not looked at: they are there to spare the complex
    factorisation that it takes, and their own error is proved.

    Parameters
    ----------
    parts : iterable of Part
        Models and data of the tests.
    x : ndarray of float, shape (n,)
        The estimate.

    Returns
    -------
    Rounding or None
        The worst of them; None where rounding is small, or small beside the residual of the fit.
    """
    found = []
    for part in parts:
        if part.solver.tier not in EXACT_TIERS:
            continue
        at = np.unique(np.linspace(0, part.n_lines - 1, _few(part)).astype(int))
        measured = np.abs(part.frf.values)
        try:
            share = _shares(part, x, part.frf.freq[at])
            left = np.abs(part.responses(x) - part.frf.values)
        except SolverError:
            continue
        misfit = np.median(left / np.where(measured > 0.0, measured, np.inf), axis=0)
        seen = (share > _FINE) & (share > _SMALL * misfit) & (part.sign != 0.0)
        share = np.where(seen, share, 0.0)
        i, j, k = (int(n) for n in np.unravel_index(np.argmax(share), share.shape))
        if share[i, j, k] > 0.0:
            channel = (part.frf.responses.labels[j], part.frf.references.labels[k])
            found.append(
                Rounding(float(share[i, j, k]), float(part.frf.freq[at[i]]), *channel, part.name)
            )
    return max(found, key=lambda r: r.share, default=None)


def _few(part: Part) -> int:
    """Return the number of lines that are looked at, which take two solutions each."""
    n = part.solver.system.n
    if n > _MANY:
        return 1
    return _LINES if n <= _LARGE else int(np.clip(part.n_lines // _SHARE, 1, _LINES))


def _shares(part: Part, x: NDArray[np.float64], freq: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the relative rounding error at some lines, shape (n_f, n_i, n_j)."""
    solver, system = part.solver, part.solver.system
    Z = system.coefficients(part.unknowns.state(system, part.values(x)), 2.0 * np.pi * freq)
    columns, place = np.unique(part.columns, return_inverse=True)
    X, Y = (
        solver.at(solver.solve(times * Z, columns, freq), part.rows)[..., place]
        for times in (1.0, 3.0)
    )
    size = np.abs(X)
    # A motion that is exactly zero is not rounded.
    return np.asarray(np.abs(3.0 * Y - X) / np.where(size > 0.0, size, np.inf)).transpose(1, 0, 2)
