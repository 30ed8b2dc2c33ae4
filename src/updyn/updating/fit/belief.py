"""Whether the place where tries of a search ended may be the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.trust_region import Outcome
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import log_error

__all__ = ["SAME", "Belief"]

_Vector = NDArray[np.float64]

#: Costs that differ by less than this share are those of one basin.
SAME = 1e-3
#: A serial correlation of the residual that noise may have, and that noise alone has.
_CORRELATED, _UNCORRELATED = 0.3, 0.1
#: Times the log error that noise explains, an error that it may explain.
_MARGIN = 1.5
#: A log misfit above this (rms) is no noise.
_GROSS = 0.3
#: A log misfit below this (rms) is exact data; there is nothing better to find.
_EXACT = 1e-7
#: Fewest lines of which a serial correlation is judged.
_ENOUGH_LINES = 8
#: So often an answer is found to be believed: that looks like noise, that may, that does not.
_TWICE, _THRICE, _OFTEN = 2, 3, 6


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Judges the ends of tries.

    Parameters
    ----------
    problem : Problem
        What was searched; its data carry what is known of the noise.
    noise_known : bool
        Whether its size is known, so that more misfit is no noise.
    """

    problem: Problem
    noise_known: bool = False

    def believed(self, ends: Sequence[Outcome]) -> bool:
        """Whether the best basin was found often enough.

        Once of exact data; twice where its residual looks like noise; three times where it may be
        noise; and else as often as a round has random tries: the tries before them begin with the
        same stiffnesses and masses.
        """
        if not ends:
            return False
        best = min(ends, key=lambda end: end.local.cost)
        agree = sum(end.local.cost <= best.local.cost * (1.0 + SAME) for end in ends)
        if self.exact(best):
            return True
        gross = _power(self._misfits(best.x)) > _GROSS**2
        if gross or (self.noise_known and not self._explained(best.local.cost)):
            return agree >= _OFTEN
        return agree >= (_TWICE if self.is_noise(best.x) else _THRICE)

    def exact(self, end: Outcome) -> bool:
        """Whether the residual of an end is only rounding of the data."""
        return _power(self._misfits(end.x)) < _EXACT**2

    def plausible(self, end: Outcome) -> bool:
        """Whether an end may be the answer: its residual looks like noise, or is no larger."""
        if self._explained(end.local.cost):
            return True
        return not self.noise_known and self.is_noise(end.x, _UNCORRELATED)

    def is_answer(self, x: _Vector, cost: float) -> bool:
        """Whether the residual at x looks like noise, and is no larger than noise of known size.

        Parameters
        ----------
        x : ndarray of float, shape (n,)
            Where.
        cost : float
            Half the sum of the squared log error there.
        """
        return self.is_noise(x, _UNCORRELATED) and (not self.noise_known or self._explained(cost))

    def is_noise(self, x: _Vector, most: float = _CORRELATED) -> bool:
        """Whether the residual looks like noise: small, and hardly serially correlated.

        Parameters
        ----------
        x : ndarray of float, shape (n,)
            Where.
        most : float
            Largest correlation of neighbouring lines.
        """
        misfits = self._misfits(x)
        power = _power(misfits)
        if min(len(r) for r in misfits) < _ENOUGH_LINES or power > _GROSS**2:
            return False
        products = np.concatenate([(r[1:] * r[:-1].conj()).real.ravel() for r in misfits])
        return float(np.mean(products)) < most * power

    def _explained(self, cost: float) -> bool:
        return cost <= _MARGIN * self.expected()

    def expected(self) -> float:
        """Return the log error that the noise alone leaves at the truth, about."""
        total = 0.0
        for part, error in zip(self.problem.parts, log_error(self.problem).errors, strict=True):
            assert part.frf.variance is not None
            assert error.weight is not None
            power = np.where(error.weight > 0.0, np.abs(part.frf.values) ** 2, 1.0)
            share = np.where(error.weight > 0.0, part.frf.variance / power, 0.0)
            # |ln(1 + s z)|^2 is s^2 where the noise is small; where it is large, the phase is
            # anything from -pi to pi, with a mean square of pi^2 / 3, and the level is that of the
            # noise.
            most = np.pi**2 / 3.0 + 0.25 * np.log1p(share) ** 2
            total += 0.5 * float(np.sum(error.weight**2 * share / (1.0 + share / most)))
        return total

    def _misfits(self, x: _Vector) -> list[NDArray[np.complex128]]:
        """Return w ln(H_A / H_X) of each part, 0 where either is zero."""
        out = []
        for part, error in zip(self.problem.parts, log_error(self.problem).errors, strict=True):
            H, measured = part.responses(x), part.frf.values
            usable = (H != 0) & (measured != 0)
            ratio = np.where(usable, H, 1.0) / np.where(usable, measured, 1.0)
            assert error.weight is not None
            out.append(np.where(usable, error.weight * np.log(ratio), 0.0))
        return out


def _power(misfits: Sequence[NDArray[np.complex128]]) -> float:
    return float(np.mean(np.concatenate([np.abs(r).ravel() for r in misfits]) ** 2))
