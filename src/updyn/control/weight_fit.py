"""A stable, minimum-phase magnitude of low order that lies above given numbers, and closely.

In sections: log |W| = log g + sum of log |zeros| - sum of log |poles|, each a first-order factor |1 + s / w| or a
second-order one |1 + 2 z s / w + (s / w)^2| with z > 0, all of static gain 1. So every W is stable and minimum-phase by
its make, over any number of decades. What lies above is linear in log |W|: the mean of the excess over log frequency
(with a little of its largest) is brought down by a sequence of linear programs with |W| >= l at every line as their
constraints. The fit of
|W|^2 = b(w^2) / a(w^2) by one linear program a level with spectral factorisation (Wu, Boyd & Vandenberghe, Proc. 35th
IEEE CDC 1996) was tried beside it on a two-mass drive: smaller in the largest excess (order 4: 4.9 instead of 7.1),
larger in the mean (3.5 instead of 1.8), and lost in rounding from order 5 on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

__all__ = ["Bound", "fit_above"]

_Real = NDArray[np.float64]

#: What the largest excess counts beside the mean.
_SHARE = 0.1
#: Damping of sections, from a sharp resonance to two real roots far apart.
_DAMPING = (1e-3, 1e2)
#: Lines on which sections are tried.
_POOLED = 120
#: Frequencies at which a new section is tried.
_PLACES = 9
#: Starts that are followed to their end.
_FOLLOWED = 2
_STEPS = 60
#: Times that lines are taken up, and how near to the closest one they are, in log |W|.
_EXCHANGES, _NEAR = 3, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """Sections of a magnitude.

    Attributes
    ----------
    order : int
        Number of poles, and of zeros.
    p : ndarray of float, shape (1 + 2 * order,)
        Logarithms: static gain; for an odd order frequencies of a first-order zero and pole; then for each pair of
        zeros and poles frequency and damping of the zeros, frequency and damping of the poles. rad/s.
    largest, mean : float
        Largest excess, and its mean over log frequency: |W| / l of that line, and of the geometric mean.
    """

    order: int
    p: _Real
    largest: float
    mean: float

    def log_magnitude(self, omega: _Real) -> _Real:
        """Return log |W| at omega in rad/s, shape (n_f,)."""
        return _model(self.p, self.order, omega)[0]


def fit_above(omega: _Real, level: _Real, order: int | None, tolerance: float, largest_order: int) -> Bound:
    """Fit a magnitude above given numbers.

    Parameters
    ----------
    omega : ndarray of float, shape (n_f,)
        Lines in rad/s, ascending.
    level : ndarray of float, shape (n_f,)
        Above what, all above 0.
    order : int or None
        Of the magnitude; None: the lowest whose mean excess is at most 1 + `tolerance`.
    tolerance : float
        See `order`.
    largest_order : int
        Where the search for an order ends, with the best found.

    Returns
    -------
    Bound
    """
    y = np.log(level)
    weight = np.gradient(np.log(omega)) if len(omega) > 1 else np.ones(1)
    weight = weight / weight.sum()
    few = _pooled(omega, y, weight)
    found = [Bound(0, np.array([y.max()]), 0.0, 0.0)]
    while True:
        full = _raised(found[-1], omega, y, weight)
        enough = full.mean <= 1.0 + tolerance or full.order >= largest_order
        if enough if order is None else full.order >= order:
            return _polished(full, few, omega, y, weight)
        found.append(_grown(found, *few))


def _pooled(omega: _Real, y: _Real, weight: _Real) -> tuple[_Real, _Real, _Real]:
    """Return fewer lines: of each run the one that is highest, with the weight of all."""
    runs = np.array_split(np.arange(len(omega)), min(_POOLED, len(omega)))
    at = np.array([run[np.argmax(y[run])] for run in runs])
    return omega[at], y[at], np.array([weight[run].sum() for run in runs])


def _grown(found: list[Bound], omega: _Real, y: _Real, weight: _Real) -> Bound:
    """Return the best bound of the next order: the last but one with a pair, or the last with a single, added."""
    order = found[-1].order + 1
    base = found[order - 1].p if order % 2 else found[order - 2].p
    places = np.log(np.geomspace(omega[0], omega[-1], _PLACES))
    starts = []
    for w in places:
        for shift in (0.7, -0.7):
            if order % 2:
                starts.append(np.concatenate([base[:1], [w + shift, w - shift], base[1:]]))
            else:
                starts.append(np.concatenate([base, [w + shift, 0.0, w - shift, 0.0]]))
        if order % 2 == 0:
            for zeros, poles in ((1.0, 0.2), (0.2, 1.0), (0.5, 0.05)):
                starts.append(np.concatenate([base, [w, np.log(zeros), w, np.log(poles)]]))
    first = [_descend(p, order, omega, y, weight, 1) for p in starts]
    best = sorted(range(len(first)), key=lambda i: first[i][1])[:_FOLLOWED]
    ended = [_descend(first[i][0], order, omega, y, weight, _STEPS) for i in best]
    # A pole upon a zero makes the next order of any: more sections are never worse.
    last = _padded(found[-1], float(np.exp(places[_PLACES // 2])))
    ended.append(_descend(last, order, omega, y, weight, _STEPS))
    p, _ = min(ended, key=lambda one: one[1])
    return Bound(order, p, 0.0, 0.0)


def _padded(last: Bound, w: float) -> _Real:
    """Return the numbers of a bound of one order more and the same magnitude."""
    at = np.log(w)
    if last.order % 2 == 0:
        return np.concatenate([last.p[:1], [at, at], last.p[1:]])
    zero, pole = last.p[1:3]
    # (1 + s / a) (1 + s / b) is a second-order factor of frequency sqrt(a b) and damping (a + b) / (2 sqrt(a b)).
    pair = [x for a in (zero, pole) for x in (0.5 * (a + at), np.log(np.cosh(0.5 * (a - at))))]
    return np.concatenate([last.p[:1], last.p[3:], pair])


def _raised(bound: Bound, omega: _Real, y: _Real, weight: _Real) -> Bound:
    """Return the bound that just lies above at all lines."""
    excess = bound.log_magnitude(omega) - y
    lift = -float(excess.min())
    p = bound.p.copy()
    p[0] += lift
    return Bound(bound.order, p, float(np.exp(excess.max() + lift)), float(np.exp(weight @ excess + lift)))


def _polished(bound: Bound, few: tuple[_Real, _Real, _Real], omega: _Real, y: _Real, weight: _Real) -> Bound:
    """Take up the lines at which the fit on few of them lies below, and fit again."""
    best, p = bound, bound.p
    for _ in range(_EXCHANGES if bound.order else 0):
        excess = _model(p, bound.order, omega)[0] - y
        inner = np.flatnonzero((excess[1:-1] <= excess[:-2]) & (excess[1:-1] <= excess[2:])) + 1
        lowest = inner[excess[inner] < excess.min() + _NEAR]
        at, above, share = few
        few = (
            np.concatenate([at, omega[lowest]]),
            np.concatenate([above, y[lowest]]),
            np.concatenate([share, np.zeros(len(lowest))]),
        )
        p, _ = _descend(p, bound.order, *few, _STEPS)
        now = _raised(Bound(bound.order, p, 0.0, 0.0), omega, y, weight)
        if now.mean < best.mean:
            best = now
    return best


def _descend(p: _Real, order: int, omega: _Real, y: _Real, weight: _Real, steps: int) -> tuple[_Real, float]:
    """Bring the excess down by linear programs in a box that shrinks where one has promised too much."""
    lower, upper = _bounds(order, omega)
    p, f, J, cost = _lifted(np.clip(p, lower, upper), order, omega, y, weight)
    n, box = len(p), 1.0
    for _ in range(steps):
        low, high = np.maximum(lower - p, -box), np.minimum(upper - p, box)
        low[0], high[0] = -20.0, 20.0
        # Unknowns: the step, and the largest excess after it.
        rows = np.block([[-J, np.zeros((len(y), 1))], [J, -np.ones((len(y), 1))]])
        target = np.concatenate([f - y, y - f])
        aim = np.concatenate([weight @ J, [_SHARE]])
        limits = np.column_stack([np.append(low, 0.0), np.append(high, np.inf)])
        program = linprog(aim, A_ub=rows, b_ub=target, bounds=limits, method="highs")
        if program.status != 0:
            break
        promised = cost - (program.fun + weight @ (f - y))
        q, g, K, now = _lifted(p + program.x[:n], order, omega, y, weight)
        if now < cost:
            gained = cost - now
            p, f, J, cost = q, g, K, now
            box = min(2.0 * box, 3.0) if gained > 0.5 * promised else box
            if gained < 1e-4 * max(cost, 1e-3):
                break
        else:
            box /= 3.0
            if box < 1e-3:
                break
    return p, cost


def _lifted(p: _Real, order: int, omega: _Real, y: _Real, weight: _Real) -> tuple[_Real, _Real, _Real, float]:
    """Return the numbers with the gain that just lies above, log |W|, its slopes, and the cost."""
    f, J = _model(p, order, omega)
    lift = float((y - f).max())
    p, f = p.copy(), f + lift
    p[0] += lift
    return p, f, J, float(weight @ (f - y) + _SHARE * (f - y).max())


def _bounds(order: int, omega: _Real) -> tuple[_Real, _Real]:
    w, z = (np.log(0.1 * omega[0]), np.log(10.0 * omega[-1])), np.log(_DAMPING)
    single, pair = order % 2, order // 2
    lower = [-np.inf] + [w[0]] * (2 * single) + [w[0], z[0]] * (2 * pair)
    upper = [np.inf] + [w[1]] * (2 * single) + [w[1], z[1]] * (2 * pair)
    return np.array(lower), np.array(upper)


def _model(p: _Real, order: int, omega: _Real) -> tuple[_Real, _Real]:
    """Return log |W|, shape (n_f,), and its derivatives, shape (n_f, n)."""
    f = np.full(len(omega), p[0])
    slopes = [np.ones(len(omega))]
    at = 1
    if order % 2:
        for sign in (1.0, -1.0):
            x = (omega / np.exp(p[at])) ** 2
            f = f + sign * 0.5 * np.log1p(x)
            slopes.append(-sign * x / (1.0 + x))
            at += 1
    for w, z in p[at:].reshape(-1, 2):
        sign = 1.0 if len(slopes) % 4 == (3 if order % 2 else 1) else -1.0
        x, zz = (omega / np.exp(w)) ** 2, np.exp(2.0 * z)
        q = (1.0 - x) ** 2 + 4.0 * zz * x
        f = f + sign * 0.5 * np.log(q)
        slopes += [sign * x * (2.0 * (1.0 - x) - 4.0 * zz) / q, sign * 4.0 * zz * x / q]
    return f, np.column_stack(slopes)
