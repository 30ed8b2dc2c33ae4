"""`follow_branch`: solutions along a band through turning points, by arc-length continuation.

Each step goes along the tangent of the branch in the scaled unknowns (x / X, omega / band), and
returns to the branch at right angles to it (Seydel, Practical Bifurcation and Stability Analysis,
2010, chapter 4). The requested lines within a step are found on its cubic Hermite interpolation and
solved at their own frequency.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.periodic.balance import Evaluation, Residual
from updyn.dynamics.periodic.newton import measure_amplitude, solve_at
from updyn.dynamics.periodic.settings import BALANCE, CONTINUATION
from updyn.errors import SolverError

__all__ = ["BranchPoint", "follow_branch"]


@dataclass(frozen=True, slots=True, eq=False)
class BranchPoint:
    """A solution on a branch; `line` is the position of its requested line, -1 between lines."""

    found: Evaluation
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class _Scale:
    """Scale of the coordinates, (n_e, 1), and of omega."""

    x: RealArray
    omega: float

    def pack(self, x: RealArray, omega: float) -> RealArray:
        """Return scaled unknowns, (n + 1,)."""
        return np.append((x / self.x).ravel(), omega / self.omega)

    def unpack(self, y: RealArray) -> tuple[RealArray, float]:
        """Return coordinates and omega."""
        return self.x * y[:-1].reshape(len(self.x), -1), float(y[-1] * self.omega)

    def border(self, found: Evaluation, row: RealArray) -> RealArray:
        """Return the scaled derivatives of the residual with one more row, (n + 1, n + 1)."""
        n = len(row) - 1
        rows = np.broadcast_to(self.x, found.x.shape).ravel()
        out = np.empty((n + 1, n + 1))
        out[:n, :n] = found.jacobian * rows / rows[:, None]
        out[:n, n] = found.by_omega.ravel() / rows * self.omega
        out[n] = row
        return out

    def tangent(self, found: Evaluation, before: RealArray) -> RealArray:
        """Return the unit tangent in the direction of `before`."""
        right = np.append(np.zeros(len(before) - 1), 1.0)
        t = np.linalg.solve(self.border(found, before), right)
        return np.asarray(t / np.linalg.norm(t))


#: The next point, its tangent, its distance from the tangent over the step, and points at lines.
_Step: TypeAlias = tuple[Evaluation, RealArray, float, list[BranchPoint]]


def follow_branch(
    balance: Residual, start: Evaluation, lines: RealArray, *, limit: float | None = None
) -> Iterator[BranchPoint]:
    """Yield the solutions from the first of `lines` (rad/s, monotonic) until the last is passed.

    `start` is the solution at the first line. Raises SolverError if the branch cannot be followed,
    or turns back beyond `limit`.
    """
    yield BranchPoint(start, 0)
    if len(lines) == 1:
        return
    band = abs(lines[-1] - lines[0])
    forward = np.sign(lines[-1] - lines[0])
    if limit is None:
        limit = float(lines[0] - forward * CONTINUATION.beyond_band * min(band, lines.min()))
    first = largest = measure_amplitude(start.x)
    now, step = start, CONTINUATION.first_step
    heading = np.zeros_like(start.x), float(forward)
    for _ in range(CONTINUATION.most_steps):
        least = CONTINUATION.least_amplitude * largest
        scale = _Scale(np.maximum(measure_amplitude(now.x), least), float(band))
        t = scale.tangent(now, scale.pack(*heading))
        step, (after, end, bend, at_lines) = _advance(balance, scale, now, t, step, lines)
        yield from at_lines
        if (after.omega - lines[-1]) * forward >= 0.0:
            return
        yield BranchPoint(after, -1)
        if (after.omega - limit) * forward < 0.0:
            raise SolverError(
                f"the branch turns back beyond {_hertz(limit):g} Hz; begin with a line further away"
            )
        amplitude = measure_amplitude(after.x)
        if (amplitude > CONTINUATION.unbounded * first).any():
            raise SolverError(f"the motion is unbounded at {_hertz(after.omega):g} Hz: no damping")
        largest = np.maximum(largest, amplitude)
        heading, now = scale.unpack(end), after
        growth = CONTINUATION.wanted_bend / max(bend, np.finfo(np.float64).tiny)
        most = CONTINUATION.largest_growth
        step = min(step * float(np.clip(growth, 1.0 / most, most)), CONTINUATION.largest_step)
    raise SolverError(
        f"the branch is not at its end after {CONTINUATION.most_steps} steps, at"
        f" {_hertz(now.omega):g} Hz; use fewer lines, or a narrower band"
    )


def _advance(
    balance: Residual,
    scale: _Scale,
    now: Evaluation,
    t: RealArray,
    step: float,
    lines: RealArray,
) -> tuple[float, _Step]:
    """Return the length of a successful step and its result; SolverError if every step fails."""
    while step >= CONTINUATION.least_step:
        taken = _take_step(balance, scale, now, t, step, lines)
        if taken is not None:
            return step, taken
        step *= 0.5
        if step > CONTINUATION.corner_step:
            continue
        for direction in _find_corner(balance, scale, now, t, step):
            for longer in CONTINUATION.corner_steps:
                taken = _take_step(balance, scale, now, direction, longer * step, lines)
                if taken is not None and not _goes_back(scale, now, taken[0], t):
                    return longer * step, taken
    raise SolverError(
        f"the periodic response cannot be followed beyond {_hertz(now.omega):g} Hz; use more"
        " harmonics=, a lower level=, or another band"
    )


def _goes_back(scale: _Scale, now: Evaluation, after: Evaluation, t: RealArray) -> bool:
    """Return whether a point lies on the branch before, opposite to its tangent."""
    chord = scale.pack(after.x - now.x, after.omega - now.omega)
    return bool(chord @ t < -CONTINUATION.backward * np.linalg.norm(chord))


def _find_corner(
    balance: Residual, scale: _Scale, now: Evaluation, t: RealArray, step: float
) -> tuple[RealArray, ...]:
    """Return the tangent beyond a corner ahead, in both directions, that along `t` first.

    An element without a smooth force, such as a slider, gives a branch corners, at which it may
    turn by more than a right angle.
    """
    beyond = balance.evaluate(*scale.unpack(scale.pack(now.x, now.omega) + step * t))
    slopes = scale.border(beyond, t)[:-1]
    if not np.isfinite(slopes).all():  # at a resonance without damping
        return ()
    n = np.linalg.svd(slopes)[2][-1]
    if n @ t < 0.0:
        n = -n
    return n, -n


def _take_step(
    balance: Residual,
    scale: _Scale,
    now: Evaluation,
    t: RealArray,
    step: float,
    lines: RealArray,
) -> _Step | None:
    """Return the next point, its tangent and bend, and points at lines; None if it is too far."""
    corrected = _correct(balance, scale, now, t, step)
    if corrected is None:
        return None
    after, bend = corrected
    end = scale.tangent(after, t)
    points = []
    for point in _solve_lines(balance, scale, now, after, t, end, lines):
        if point is not None:
            points.append(point)
        elif step > CONTINUATION.least_line_step:
            return None
    return after, end, bend, points


def _correct(
    balance: Residual, scale: _Scale, now: Evaluation, t: RealArray, step: float
) -> tuple[Evaluation, float] | None:
    """Return the next point and its distance from the tangent over the step; None if too far."""
    y0 = scale.pack(now.x, now.omega) + step * t
    y = y0
    for _ in range(CONTINUATION.most_iterations):
        x, omega = scale.unpack(y)
        if omega <= balance.least:
            return None
        found = balance.evaluate(x, omega)
        size = np.max(np.abs(found.residual) / measure_amplitude(x))
        if not np.isfinite(size):
            return None
        if size <= BALANCE.residual:
            bend = float(np.linalg.norm(y - y0)) / step
            return (found, bend) if bend <= CONTINUATION.largest_bend else None
        residual = np.append((found.residual / scale.x).ravel(), t @ (y - y0))
        try:
            y = y - np.linalg.solve(scale.border(found, t), residual)
        except np.linalg.LinAlgError:
            return None
    return None


def _solve_lines(
    balance: Residual,
    scale: _Scale,
    now: Evaluation,
    after: Evaluation,
    t: RealArray,
    end: RealArray,
    lines: RealArray,
) -> Iterator[BranchPoint | None]:
    """Yield the solutions at requested lines between two points in order, None if not found."""
    a, b = scale.pack(now.x, now.omega), scale.pack(after.x, after.omega)
    length = np.linalg.norm(b - a)
    # Hermite polynomial, coefficients of s^3, s^2, s and 1 for s from 0 to 1.
    cubic = np.array(
        [
            2.0 * (a - b) + length * (t + end),
            3.0 * (b - a) - length * (2.0 * t + end),
            length * t,
            a,
        ]
    )
    s = np.linspace(0.0, 1.0, 17)
    passed = np.polyval(cubic[:, -1], s) * scale.omega
    low, high = passed.min(), passed.max()
    margin = 0.1 * (high - low)
    crossings: list[tuple[float, int]] = []
    near = (lines >= low - margin) & (lines <= high + margin)
    for number in np.flatnonzero(near).tolist():
        polynomial = cubic[:, -1].copy()
        polynomial[-1] -= lines[number] / scale.omega
        roots = np.roots(polynomial)
        real = roots.real[np.abs(roots.imag) <= 1e-9]
        crossings += [(float(share), number) for share in real if 0.0 < share <= 1.0]
    for share, line in sorted(crossings):
        y = np.array([share**3, share**2, share, 1.0]) @ cubic
        found = solve_at(balance, scale.unpack(y)[0], float(lines[line]))
        if found is None or np.linalg.norm(scale.pack(found.x, found.omega) - y) > length:
            yield None
        else:
            yield BranchPoint(found, line)


def _hertz(omega: float) -> float:
    return float(omega / (2.0 * np.pi))
