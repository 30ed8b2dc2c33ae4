"""Criteria to accept the end of a try of a search as the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.fit.settings import ACCEPTANCE, ANSWER_RESIDUAL
from updyn.updating.fit.trust_region import Outcome
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import make_log_error

__all__ = ["Acceptance"]


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """Criteria to accept the end of a try as the answer.

    The data of `problem` carry the known part of the noise. With `noise_known`, a misfit larger
    than that of the noise is not noise.
    """

    problem: Problem
    noise_known: bool = False

    def is_accepted(self, ends: Sequence[Outcome]) -> bool:
        """Return whether the best basin was found often enough."""
        # Once for exact data, twice if the residual looks like noise, three times if it may be
        # noise; otherwise as often as a round has random tries, because the tries before them
        # begin with the same stiffnesses and masses.
        if not ends:
            return False
        best = min(ends, key=lambda end: end.local.cost)
        agree = sum(
            end.local.cost <= best.local.cost * (1.0 + ACCEPTANCE.same_basin_share) for end in ends
        )
        if self.is_exact(best):
            return True
        gross = _power(self._misfits(best.x)) > ACCEPTANCE.gross_misfit**2
        if gross or (self.noise_known and not self._is_explained_by_noise(best.local.cost)):
            return agree >= ACCEPTANCE.tries_if_not_noise
        return agree >= (
            ACCEPTANCE.tries_if_noise if self.is_noise(best.x) else ACCEPTANCE.tries_if_unclear
        )

    def is_exact(self, end: Outcome) -> bool:
        """Return whether the residual of an end is only rounding of the data."""
        return _power(self._misfits(end.x)) < ACCEPTANCE.exact_misfit**2

    def is_plausible(self, end: Outcome) -> bool:
        """Return whether an end may be the answer: its residual is like noise, or no larger."""
        if self._is_explained_by_noise(end.local.cost):
            return True
        return not self.noise_known and self.is_noise(end.x, ACCEPTANCE.certain_correlation)

    def is_answer(self, x: RealArray, cost: float) -> bool:
        """Return whether the residual at x looks like noise, no larger than noise of known size."""
        return self.is_noise(x, ACCEPTANCE.certain_correlation) and (
            not self.noise_known or self._is_explained_by_noise(cost)
        )

    def is_noise(self, x: RealArray, most: float | None = None) -> bool:
        """Return whether the residual at x is small, and its serial correlation at most `most`."""
        if most is None:
            most = ACCEPTANCE.possible_correlation
        misfits = self._misfits(x)
        power = _power(misfits)
        if (
            min(len(r) for r in misfits) < ANSWER_RESIDUAL.least_lines
            or power > ACCEPTANCE.gross_misfit**2
        ):
            return False
        products = np.concatenate([(r[1:] * r[:-1].conj()).real.ravel() for r in misfits])
        return float(np.mean(products)) < most * power

    def _is_explained_by_noise(self, cost: float) -> bool:
        return cost <= ACCEPTANCE.explained_ratio * self.expected_cost()

    def expected_cost(self) -> float:
        """Return the approximate log error of the noise alone, at the true values."""
        total = 0.0
        for part, error in zip(
            self.problem.parts, make_log_error(self.problem).errors, strict=True
        ):
            assert part.frf.variance is not None
            assert error.weight is not None
            power = np.where(error.weight > 0.0, np.abs(part.frf.values) ** 2, 1.0)
            share = np.where(error.weight > 0.0, part.frf.variance / power, 0.0)
            # |ln(1 + s z)|^2 is s^2 for small noise. For large noise, the phase is uniform between
            # -pi and pi, with a mean square of pi^2 / 3, and the level is that of the noise.
            most = np.pi**2 / 3.0 + 0.25 * np.log1p(share) ** 2
            total += 0.5 * float(np.sum(error.weight**2 * share / (1.0 + share / most)))
        return total

    def _misfits(self, x: RealArray) -> list[ComplexArray]:
        """Return w ln(H_A / H_X) of each part, 0 if either value is zero."""
        out = []
        for part, error in zip(
            self.problem.parts, make_log_error(self.problem).errors, strict=True
        ):
            H, measured = part.responses(x), part.frf.values
            usable = (H != 0) & (measured != 0)
            ratio = np.where(usable, H, 1.0) / np.where(usable, measured, 1.0)
            assert error.weight is not None
            out.append(np.where(usable, error.weight * np.log(ratio), 0.0))
        return out


def _power(misfits: Sequence[ComplexArray]) -> float:
    return float(np.mean(np.concatenate([np.abs(r).ravel() for r in misfits]) ** 2))
