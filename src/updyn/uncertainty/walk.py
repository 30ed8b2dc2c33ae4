"""The walk along the profile of one unknown: out from a minimum to the level, or to a bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from updyn.uncertainty.likelihood import Likelihood, Point
from updyn.uncertainty.profiles import Hump, Profile

__all__ = ["Walk"]

_Vector = NDArray[np.float64]

#: Steps between two points, in standard deviations, and how near to the level its crossing is
#: found.
_STRIDE, _CLOSE = 0.5, 2e-3
#: Largest step, as a share of the way between the bounds.
_SHARE = 0.1
_STEPS, _HALVINGS, _ROOTS = 60, 5, 40
_ROUNDING = 1e-12


@dataclass(slots=True, eq=False)
class Walk:
    """The profile of one unknown, in the optimiser's coordinates.

    Parameters
    ----------
    likelihood : Likelihood
        What is profiled.
    tops : sequence of Point
        Its minima, the best first.
    k : int
        The unknown.
    drop : float
        Fall of the log-likelihood at the ends of the interval.
    """

    likelihood: Likelihood
    tops: Sequence[Point]
    k: int
    drop: float
    _points: list[Point] = field(default_factory=list, init=False)

    @property
    def best(self) -> Point:
        """The minimum that falls are counted from."""
        return self.tops[0]

    def run(self) -> tuple[Profile, Point]:
        """Return the profile and the best point on the way."""
        humps: list[tuple[Hump, str, str]] = []
        for top in self.tops:
            if self._fall(top) < self.drop and not _within(top.x[self.k], humps):
                humps.append(self._hump(top))
        humps.sort(key=lambda h: h[0].lower)
        points = sorted(self._points, key=lambda p: p.x[self.k])
        merged = _merged(humps)
        found = Profile(
            self.likelihood.problem.coordinates.parameters.names[self.k],
            float(self.best.x[self.k]),
            np.array([p.x[self.k] for p in points]),
            np.array([p.cost - self.best.cost for p in points]),
            np.array([p.x for p in points]),
            tuple(merged),
            min(humps, key=lambda h: h[0].lower)[1],
            max(humps, key=lambda h: h[0].upper)[2],
        )
        return found, min(points, key=lambda p: p.cost)

    # -- one hump ------------------------------------------------------------------------------------------
    def _hump(self, top: Point) -> tuple[Hump, str, str]:
        """Return the range about a minimum, and why it ends on each side."""
        self._points.append(top)
        (low, why_low), (high, why_high) = (self._end(top, side) for side in (-1.0, 1.0))
        return Hump(low, float(top.x[self.k]), high, top.cost - self.best.cost), why_low, why_high

    def _end(self, top: Point, side: float) -> tuple[float, str]:
        """Return where the range about a minimum ends on one side, and why."""
        bound = float(self.likelihood.bounds[0 if side < 0 else 1][self.k])
        here = top
        for _ in range(_STEPS):
            room = side * (bound - here.x[self.k])
            if room <= _ROUNDING * max(1.0, abs(bound)):
                return bound, self._name_of(side, bound)
            there = self._onward(here, side, min(self._stride(here, side), room))
            if there is None:
                return float(here.x[self.k]), "unsolved"
            self._points.append(there)
            if self._fall(there) >= self.drop:
                return self._crossing(here, there, side), "level"
            here = there
        return float(here.x[self.k]), "unsolved"

    def _name_of(self, side: float, bound: float) -> str:
        factor = self.likelihood.problem.coordinates.parameters.is_factor[self.k]
        return "zero" if side < 0 and bound == 0.0 and not factor else "bound"

    def _fall(self, point: Point) -> float:
        return point.cost - self.best.cost

    def _stride(self, here: Point, side: float) -> float:
        """Return the step after which the fall should be that of so many standard deviations more."""
        z = np.sqrt(2.0 * max(self._fall(here), 0.0)) + _STRIDE
        return min(self._reach(here, side, 0.5 * z**2), self._longest)

    @property
    def _longest(self) -> float:
        lower, upper = (b[self.k] for b in self.likelihood.bounds)
        return float(_SHARE * (upper - lower))

    def _reach(self, here: Point, side: float, fall: float) -> float:
        """Return the step to where the fall is as given, by the local model of the profile; inf where it is flat.

        Along the profile the cost is cost + g h + S h^2 / 2: g its slope by this unknown alone, as
        the others are at their minimum, and S what of its curvature the others cannot follow (the
        Schur complement).
        """
        g = side * float(here.local.gradient[self.k])
        S = float(np.sum(self._follow(here)[1] ** 2))
        left = fall - self._fall(here)
        inside = g * g + 2.0 * S * left
        if g > 0.0:  # the larger part of the sum first: S may be rounding
            return 2.0 * left / (g + float(np.sqrt(max(inside, 0.0))))
        return float((np.sqrt(max(inside, 0.0)) - g) / S) if S > 0.0 else np.inf

    def _follow(self, here: Point) -> tuple[_Vector, _Vector]:
        """Return how the others follow this unknown, by unit of it, shape (n,), and what of its column is left."""
        lower, upper = self.likelihood.bounds
        gradient, column = here.local.gradient, here.local.R[:, self.k]
        held = ((here.x <= lower) & (gradient > 0)) | ((here.x >= upper) & (gradient < 0))
        held[self.k] = True
        A = here.local.R[:, ~held]
        norms = np.linalg.norm(A, axis=0)
        scale = np.where(norms > 0, norms, 1.0)
        share = np.linalg.lstsq(A / scale, -column, rcond=1e-10)[0] / scale
        out = np.zeros(len(here.x))
        out[~held] = share
        out[self.k] = 1.0
        return out, column + A @ share

    def _onward(self, here: Point, side: float, h: float) -> Point | None:
        """Return the profile a step further out; a shorter one where the model cannot be solved there."""
        lower, upper = self.likelihood.bounds
        along = self._follow(here)[0]
        for _ in range(_HALVINGS):
            target = float(np.clip(here.x[self.k] + side * h, lower[self.k], upper[self.k]))
            moved = np.clip(here.x + along * (target - here.x[self.k]), lower, upper)
            stayed = np.array(here.x)
            moved[self.k] = stayed[self.k] = target
            for start in (moved, stayed):
                found = self.likelihood.descend(start, self.k)
                if found is not None:
                    return found
            h *= 0.5
        return None

    def _crossing(self, inside: Point, outside: Point, side: float) -> float:
        """Return where the fall is that of the level, between two points of the profile."""
        wanted, widths = np.sqrt(2.0 * self.drop), [np.inf, np.inf]
        for _ in range(_ROOTS):
            a, b = (float(p.x[self.k]) for p in (inside, outside))
            za, zb = (np.sqrt(2.0 * max(self._fall(p), 0.0)) for p in (inside, outside))
            order = (inside, outside) if wanted - za < zb - wanted else (outside, inside)
            if min(wanted - za, zb - wanted) < _CLOSE * wanted or abs(b - a) < 1e-12:
                break
            guess = (
                self._guess(order, a, b, side) if abs(b - a) <= 0.5 * widths[-2] else 0.5 * (a + b)
            )
            widths.append(abs(b - a))
            there = self._onward(order[0], 1.0, guess - float(order[0].x[self.k]))
            if there is None:
                break
            self._points.append(there)
            if self._fall(there) >= self.drop:
                outside = there
            else:
                inside = there
        # What is left is less than a hundredth of a standard deviation: the curve between is
        # straight.
        if zb - za < 1e-12:
            return b
        return float(a + (b - a) * np.clip((wanted - za) / (zb - za), 0.0, 1.0))

    def _guess(self, points: tuple[Point, Point], a: float, b: float, side: float) -> float:
        """Return where the first local model with a crossing inside the bracket puts it; else the middle.

        Where an unknown meets its bound, the profile has a kink, and only the model on that side of
        it is right.
        """
        margin = 0.02 * abs(b - a)
        low, high = min(a, b) + margin, max(a, b) - margin
        for point in points:
            guess = float(point.x[self.k]) + side * self._reach(point, side, self.drop)
            if low <= guess <= high:
                return guess
        return 0.5 * (a + b)


def _within(x: float, humps: list[tuple[Hump, str, str]]) -> bool:
    return any(h.lower <= x <= h.upper for h, _, _ in humps)


def _merged(humps: list[tuple[Hump, str, str]]) -> list[Hump]:
    """Return the ranges, those that overlap as one."""
    out: list[Hump] = []
    for hump, _, _ in humps:
        if out and hump.lower <= out[-1].upper:
            best = min(out[-1], hump, key=lambda h: h.drop)
            out[-1] = Hump(
                min(out[-1].lower, hump.lower), best.best, max(out[-1].upper, hump.upper), best.drop
            )
        else:
            out.append(hump)
    return out
