"""`Weight`: a stable minimum-phase transfer function; its fit as an upper bound of a magnitude."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain, pairwise, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from updyn.arrays import ComplexArray, RealArray
from updyn.control.servo.state_space import connect_sections, root_pair
from updyn.control.settings import WEIGHT_FIT

__all__ = [
    "Bound",
    "Weight",
    "bound_roots",
    "fit_above",
]

_Lines = tuple[RealArray, RealArray, RealArray]


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """A stable, minimum-phase transfer function W(s) = gain * prod (s - zeros) / prod (s - poles).

    `zeros` and `poles` are in rad/s; for an odd order the first is a single real root, followed by
    pairs. `largest` and `mean` (geometric, over log frequency) are the excess |W| / l of a line;
    `peak` is the largest l, at `peak_at` Hz. A, B, C, D are sections in series, time in s:
    ``control.ss(w.A, w.B, w.C, w.D)`` in python-control.
    """

    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    largest: float = 1.0
    mean: float = 1.0
    peak: float = 0.0
    peak_at: float = 0.0
    note: str = ""
    A: RealArray = field(init=False, repr=False)
    B: RealArray = field(init=False, repr=False)
    C: RealArray = field(init=False, repr=False)
    D: RealArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system = connect_sections(self.zeros, self.poles, self.gain)
        for name in "ABCD":
            array = getattr(system, name)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        return (
            f"Weight(order {self.order}, at most {self.largest:.3g} times the radius,"
            f" {self.mean:.3g} in the mean)"
        )

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.poles)

    def at(self, freq: ArrayLike) -> ComplexArray:
        """Return W at lines in Hz, shape (n_f,)."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64))[:, None]
        return np.asarray(self.gain * np.prod((s - self.zeros) / (s - self.poles), axis=1))


def bound_roots(bound: Bound, lift: float = 0.0) -> tuple[ComplexArray, ComplexArray, float]:
    """Return zeros and poles in rad/s and the gain of a bound whose log is increased by `lift`."""
    zeros: list[complex] = []
    poles: list[complex] = []
    gain = float(np.exp(bound.p[0] + lift))
    at = 1
    if bound.order % 2:
        wz, wp = np.exp(bound.p[1:3])
        zeros.append(complex(-wz))
        poles.append(complex(-wp))
        gain *= wp / wz
        at = 3
    for w_zero, d_zero, w_pole, d_pole in np.exp(bound.p[at:]).reshape(-1, 4):
        zeros += root_pair(w_zero, d_zero)
        poles += root_pair(w_pole, d_pole)
        gain *= (w_pole / w_zero) ** 2
    return np.array(zeros, dtype=np.complex128), np.array(poles, dtype=np.complex128), gain


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """A magnitude as a product of sections, with its largest and mean excess |W| / l of a line.

    `p`, shape (1 + 2 order,), are logarithms: static gain; for an odd order frequencies of a
    first-order zero and pole; then for each pair of zeros and poles frequency and damping of the
    zeros, frequency and damping of the poles, in rad/s.
    """

    order: int
    p: RealArray
    largest: float
    mean: float

    def log_magnitude(self, omega: RealArray) -> RealArray:
        """Return log |W| at omega in rad/s, shape (n_f,)."""
        return _model(self.p, self.order, omega)[0]


def fit_above(
    omega: RealArray, level: RealArray, order: int | None, tolerance: float, largest_order: int
) -> Bound:
    """Return a magnitude above a positive level at ascending lines in rad/s.

    Without an `order`, the lowest of 0, 1, 2, 4, 6 ... with a mean excess of at most 1 +
    `tolerance`, or the best up to `largest_order`.
    """
    y = np.log(level)
    weight = np.gradient(np.log(omega)) if len(omega) > 1 else np.ones(1)
    weight = weight / weight.sum()
    few = _thin_lines(omega, y, weight)
    even = best = _raise_bound(Bound(0, np.array([y.max()]), 0.0, 0.0), omega, y, weight)
    for tried in _orders(largest_order if order is None else order):
        if order is None and best.mean <= 1.0 + tolerance:
            break
        whole, few = _polish_bound(_add_section(even, tried, *few), few, omega, y, weight)
        if tried % 2 == 0:
            even = whole
        if order is not None or whole.mean < best.mean:
            best = whole
    return best


def _orders(last: int) -> list[int]:
    """Return the orders up to the last one: 1, then in steps of 2."""
    return sorted({n for n in (1, *range(2, last + 1, 2), last) if 0 < n <= last})


def _thin_lines(omega: RealArray, y: RealArray, weight: RealArray) -> _Lines:
    """Return fewer lines: the highest of each run, with the total weight of the run."""
    # Half of the share by the number of lines, dense around resonances, half by log frequency, as
    # in the mean.
    share = np.linspace(0.0, 0.5, len(omega)) + 0.5 * np.log(omega / omega[0]) / max(
        np.log(omega[-1] / omega[0]), 1e-300
    )
    count = int(np.clip(len(omega) // 16, WEIGHT_FIT.least_lines, WEIGHT_FIT.most_lines))
    cuts = np.flatnonzero(np.diff(np.floor(share * count))) + 1
    runs = np.split(np.arange(len(omega)), cuts)
    at = np.array([run[np.argmax(y[run])] for run in runs])
    return omega[at], y[at], np.array([weight[run].sum() for run in runs])


def _add_section(
    base: Bound, order: int, omega: RealArray, y: RealArray, weight: RealArray
) -> Bound:
    """Return the best bound of an order from one of lower order, by an additional pole and zero."""
    p, count, d = base.p, WEIGHT_FIT.trial_frequencies, WEIGHT_FIT.root_distance
    places = np.log(np.geomspace(omega[0], omega[-1], count))
    # A coincident pole and zero change nothing, so a start with them is never worse.
    middle = places[count // 2]
    if order % 2:
        starts = [np.concatenate([p[:1], [middle, middle], p[1:]])]
        for w, half in product(places, (d, -d)):
            starts.append(np.concatenate([p[:1], [w + half, w - half], p[1:]]))
    else:
        starts = [np.concatenate([p, [middle, 0.0, middle, 0.0]])]
        for w, half in product(places, (d, -d)):
            starts.append(np.concatenate([p, [w + half, 0.0, w - half, 0.0]]))
        peak_dampings = WEIGHT_FIT.peak_dampings
        peaks = [(w, *dampings) for w, dampings in product(places, peak_dampings)]
        touched, free = _touched_and_free(base, omega, y, weight)
        at_peaks = product(touched, (*peak_dampings, *WEIGHT_FIT.spike_dampings))
        widths = chain(at_peaks, product(free, WEIGHT_FIT.dip_dampings))
        peaks += [(w, *width) for w, width in widths]
        for w, zeros, poles in peaks:
            starts.append(np.concatenate([p, [w, np.log(zeros), w, np.log(poles)]]))
    first = [_descend(start, order, omega, y, weight, 1) for start in starts]
    best = sorted(first[1:], key=lambda one: one[1])[: WEIGHT_FIT.most_starts]
    steps = WEIGHT_FIT.most_steps
    ended = [_descend(start, order, omega, y, weight, steps) for start, _ in (first[0], *best)]
    return Bound(order, min(ended, key=lambda one: one[1])[0], 0.0, 0.0)


def _touched_and_free(
    bound: Bound, omega: RealArray, y: RealArray, weight: RealArray
) -> tuple[list[float], list[float]]:
    """Return log frequencies where a bound is tight, and the middles of the widest gaps."""
    # A peak of a section at a tight place lowers the bound elsewhere; a dip in a gap lowers it
    # there.
    excess = bound.log_magnitude(omega) - y
    touched = np.argsort(excess, kind="stable")[: WEIGHT_FIT.trial_places]
    # Gaps lie between nearly tight places; their size is their area over log frequency.
    near = np.flatnonzero(excess < WEIGHT_FIT.tight_share * excess.max())
    ends = np.unique(np.concatenate([[0], near, [len(omega) - 1]]))
    areas = []
    for i, j in pairwise(ends):
        if j > i + 1:
            areas.append((float(weight[i : j + 1] @ excess[i : j + 1]), i, j))
    gaps = sorted(areas, reverse=True)[: WEIGHT_FIT.trial_places]
    x = np.log(omega)
    return [float(x[i]) for i in touched], [float(0.5 * (x[i] + x[j])) for _, i, j in gaps]


def _raise_bound(bound: Bound, omega: RealArray, y: RealArray, weight: RealArray) -> Bound:
    """Return the bound shifted to the lowest level above all lines."""
    excess = bound.log_magnitude(omega) - y
    lift = -float(excess.min())
    p = bound.p.copy()
    p[0] += lift
    return Bound(
        bound.order, p, float(np.exp(excess.max() + lift)), float(np.exp(weight @ excess + lift))
    )


def _polish_bound(
    bound: Bound, few: _Lines, omega: RealArray, y: RealArray, weight: RealArray
) -> tuple[Bound, _Lines]:
    """Return a bound refitted with the lines that it violates, and the extended lines."""
    best, p = _raise_bound(bound, omega, y, weight), bound.p
    for _ in range(WEIGHT_FIT.exchanges):
        excess = _model(p, bound.order, omega)[0] - y
        if excess.min() > -WEIGHT_FIT.gain_violation:
            break
        inner = np.flatnonzero((excess[1:-1] <= excess[:-2]) & (excess[1:-1] <= excess[2:])) + 1
        lowest = inner[excess[inner] < excess.min() + WEIGHT_FIT.exchange_distance]
        at, above, share = few
        every, first = np.unique(np.concatenate([at, omega[lowest]]), return_index=True)
        above = np.concatenate([above, y[lowest]])[first]
        few = every, above, np.concatenate([share, np.zeros(len(lowest))])[first]
        p, _ = _descend(p, bound.order, *few, WEIGHT_FIT.most_steps)
        now = _raise_bound(Bound(bound.order, p, 0.0, 0.0), omega, y, weight)
        if now.mean < best.mean:
            best = now
    return best, few


def _descend(
    p: RealArray, order: int, omega: RealArray, y: RealArray, weight: RealArray, steps: int
) -> tuple[RealArray, float]:
    """Reduce the excess by linear programs in a trust region; return parameters and cost."""
    lower, upper = _bounds(order, omega)
    p, f, J, cost = _lift_above(np.clip(p, lower, upper), order, omega, y, weight)
    n, box = len(p), 1.0
    for _ in range(steps):
        reach = box * _largest_step(p, order)
        low, high = np.maximum(lower - p, -reach), np.minimum(upper - p, reach)
        low[0], high[0] = -20.0, 20.0
        # Unknowns: the step, and the largest excess after it.
        rows = np.block([[-J, np.zeros((len(y), 1))], [J, -np.ones((len(y), 1))]])
        target = np.concatenate([f - y, y - f])
        aim = np.concatenate([weight @ J, [WEIGHT_FIT.largest_share]])
        limits = np.column_stack([np.append(low, 0.0), np.append(high, np.inf)])
        program = linprog(aim, A_ub=rows, b_ub=target, bounds=limits, method="highs")
        if program.status != 0:
            break
        promised = cost - (program.fun + weight @ (f - y))
        q, g, K, now = _lift_above(p + program.x[:n], order, omega, y, weight)
        if now < cost:
            gained = cost - now
            p, f, J, cost = q, g, K, now
            if gained > 0.5 * promised:
                box = min(2.0 * box, 3.0)
            if gained < 1e-4 * max(cost, 1e-3):
                break
        else:
            box /= 3.0
            if box < 1e-3:
                break
    return p, cost


def _largest_step(p: RealArray, order: int) -> RealArray:
    """Return the largest step: a few widths of a sharp section, else a factor of e."""
    reach = np.ones(len(p))
    first = 3 if order % 2 else 1
    reach[first::2] = np.minimum(1.0, 4.0 * np.exp(p[first + 1 :: 2]))
    return reach


def _lift_above(
    p: RealArray, order: int, omega: RealArray, y: RealArray, weight: RealArray
) -> tuple[RealArray, RealArray, RealArray, float]:
    """Return the parameters with the lowest gain above all lines, log |W|, slopes, and cost."""
    # The damping of a section is limited by the spacing of the lines, between which a sharper one
    # could peak.
    first = 3 if order % 2 else 1
    p = p.copy()
    gaps = np.log(np.diff(np.log(omega))) if len(omega) > 1 else np.zeros(1)
    at = 0.5 * np.log(omega[1:] * omega[:-1]) if len(omega) > 1 else np.log(omega)
    p[first + 1 :: 2] = np.maximum(p[first + 1 :: 2], np.interp(p[first::2], at, gaps))
    f, J = _model(p, order, omega)
    lift = float((y - f).max())
    f = f + lift
    p[0] += lift
    return p, f, J, float(weight @ (f - y) + WEIGHT_FIT.largest_share * (f - y).max())


def _bounds(order: int, omega: RealArray) -> tuple[RealArray, RealArray]:
    w = np.log(0.1 * omega[0]), np.log(10.0 * omega[-1])
    z = np.log((WEIGHT_FIT.least_damping, WEIGHT_FIT.largest_damping))
    single, pair = order % 2, order // 2
    lower = [-np.inf] + [w[0]] * (2 * single) + [w[0], z[0]] * (2 * pair)
    upper = [np.inf] + [w[1]] * (2 * single) + [w[1], z[1]] * (2 * pair)
    return np.array(lower), np.array(upper)


def _model(p: RealArray, order: int, omega: RealArray) -> tuple[RealArray, RealArray]:
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
        sign = 1.0 if len(slopes) % 4 == 1 + 2 * (order % 2) else -1.0
        x, zz = (omega / np.exp(w)) ** 2, np.exp(2.0 * z)
        q = (1.0 - x) ** 2 + 4.0 * zz * x
        f = f + sign * 0.5 * np.log(q)
        slopes += [sign * x * (2.0 * (1.0 - x) - 4.0 * zz) / q, sign * 4.0 * zz * x / q]
    return f, np.column_stack(slopes)
