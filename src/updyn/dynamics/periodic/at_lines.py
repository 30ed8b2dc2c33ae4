"""`LineBalance`: harmonic balance at the lines of a measurement, solved at all lines at once.

The unknowns are those of `Balance`. At a line with several solutions, that which a slowly growing
force reaches is found, and those of the smallest and the largest amplitude of each element by its
describing function.

Derivatives follow from the implicit function theorem: with the residual R(Q, p) = 0 of the balance
and its Jacobian J, dQ/dp = -J^-1 dR/dp.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, NumberArray, RealArray
from updyn.dynamics.periodic.balance import Evaluation
from updyn.dynamics.periodic.first import follow_force
from updyn.dynamics.periodic.fourier import Fourier
from updyn.dynamics.periodic.settings import LINE_BALANCE
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.over_lines import LineForces, describe_first_harmonic

__all__ = ["DeflatedBalance", "LineBalance", "LineEvaluation"]


@dataclass(frozen=True, slots=True, eq=False)
class LineEvaluation:
    """The balance at k lines: coordinates x, (k, n_e, n_c), residual, Jacobian and forces.

    `residual` has the shape of x, in m (rad); `jacobian` (k, n_e n_c, n_e n_c); `forces` T_k,
    complex (k, n_e, n_h), in N (N m); `periods` has the samples of each element.
    """

    x: RealArray
    residual: RealArray
    jacobian: RealArray
    forces: ComplexArray
    periods: tuple[LineForces, ...]

    @property
    def size(self) -> RealArray:
        """Residual over the amplitude of its element, largest of each line, shape (k,)."""
        found = np.abs(self.residual) / _amplitudes(self.x)
        return np.asarray(np.where(np.isfinite(found), found, np.inf).max(axis=(1, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class LineBalance:
    """Elements on a linear model at m lines, with one force.

    `omega` (m,) in rad/s; `level` (m,) is the amplitude of the force in N (N m); `H`, (m, n_h, n_e
    + n_i, n_e + 1), has the receptances at each harmonic: deformations of elements, then responses,
    for forces of elements, then the force.
    """

    elements: Sequence[NonlinearElement]
    fourier: Fourier
    omega: RealArray
    level: RealArray
    H: ComplexArray

    @property
    def n_elements(self) -> int:
        """Number of elements n_e."""
        return len(self.elements)

    def evaluate(
        self, x: RealArray, at: IndexArray, share: RealArray | float = 1.0
    ) -> LineEvaluation:
        """Return the balance at the lines `at` for a share of the level."""
        n, f, H, omega = self.n_elements, self.fourier, self.H[at], self.omega[at]
        u, v = x @ f.synthesis.T, omega[:, None, None] * (x @ f.rate.T)
        periods = [LineForces.of(e, u[:, i], v[:, i]) for i, e in enumerate(self.elements)]
        T = np.stack([one.force @ f.analysis.T for one in periods], axis=1)
        tangents = np.stack([self._tangent(one, omega) for one in periods], axis=1)
        forces, slopes = self._to_complex(T), self._to_complex(tangents)
        R = self._to_complex(x) + np.einsum("mkef,mfk->mek", H[:, :, :n, :n], forces)
        R[:, :, f.first] -= (self.level[at] * share)[:, None] * H[:, f.first, :n, n]
        J = self.to_coordinates(np.einsum("mkef,mfkc->mekfc", H[:, :, :n, :n], slopes))
        size = n * f.size
        J = J.reshape(len(at), size, size) + np.eye(size)
        return LineEvaluation(x, self.to_coordinates(R), J, forces, tuple(periods))

    def _tangent(self, period: LineForces, omega: RealArray) -> RealArray:
        """Return the derivative of the coordinates of a force by those of its deformation."""
        f = self.fourier
        out = (f.analysis * period.stiffness[:, None, :]) @ f.synthesis
        if period.damping.any():
            damping = omega[:, None, None] * period.damping[:, None, :]
            out = out + (f.analysis * damping) @ f.rate
        for r in range(period.earlier.shape[1]):
            later = period.memory[:, :, r] @ f.analysis.T
            out = out + later[:, :, None] * f.synthesis[period.earlier[:, r]][:, None, :]
        return np.asarray(out)

    def _to_complex(self, x: RealArray) -> ComplexArray:
        """Return harmonics along axis 2 from coordinates, (k, n_e, n_c, ...)."""
        flat = self.fourier.to_complex(x.reshape(-1, *x.shape[2:]))
        return flat.reshape(*x.shape[:2], *flat.shape[1:])

    def to_coordinates(self, U: ComplexArray) -> RealArray:
        """Return coordinates along axis 2 from harmonics, (k, n_e, n_h, ...)."""
        flat = self.fourier.to_real(U.reshape(-1, *U.shape[2:]))
        return flat.reshape(*U.shape[:2], *flat.shape[1:])

    def solve(
        self, x: RealArray, at: IndexArray, share: RealArray | float = 1.0
    ) -> tuple[RealArray, BoolArray]:
        """Return the solutions near x by damped Newton iterations, and whether each converged."""
        x, share = x.copy(), np.broadcast_to(share, at.shape)
        last = np.full(len(at), np.inf)
        if not len(at):
            return x, last <= 0.0
        active, stalls = np.arange(len(at)), np.zeros(len(at), dtype=np.intp)
        R, J, size = self._balance(x, at, share)
        for _ in range(LINE_BALANCE.most_iterations):
            last[active] = size
            kept = (size > LINE_BALANCE.residual) & np.isfinite(size)
            kept &= stalls[active] < LINE_BALANCE.most_stalls
            active, before = active[kept], size[kept]
            if not len(active):
                break
            step = _solve_each(J[kept], -R[kept]).reshape(x[active].shape)
            # Longer steps may lead to another solution.
            length = np.linalg.norm(step, axis=2, keepdims=True) / _amplitudes(x[active])
            step *= np.minimum(1.0, LINE_BALANCE.largest_step / length.max(axis=1, keepdims=True))
            x[active] += step
            R, J, size = self._balance(x[active], at[active], share[active])
            for _ in range(LINE_BALANCE.most_halvings):
                worse = np.flatnonzero(~(size < before))
                if not len(worse):
                    break
                step[worse] *= 0.5
                some = active[worse]
                x[some] -= step[worse]
                R[worse], J[worse], size[worse] = self._balance(x[some], at[some], share[some])
            stalls[active[~(size < before)]] += 1
        return x, last <= LINE_BALANCE.accepted_residual

    def _balance(
        self, x: RealArray, at: IndexArray, share: RealArray
    ) -> tuple[RealArray, RealArray, RealArray]:
        """Return residual, (k, n_e n_c), Jacobian and relative size of the residual, (k,)."""
        now = self.evaluate(x, at, share)
        return now.residual.reshape(len(at), -1), now.jacobian, now.size

    def deflate(self, known: RealArray, at: IndexArray) -> DeflatedBalance:
        """Return the balance whose iterations avoid known solutions at the lines `at`."""
        every = np.zeros((len(self.omega), *known.shape[1:]))
        every[at] = known
        return DeflatedBalance(self.elements, self.fourier, self.omega, self.level, self.H, every)

    def linear(self) -> RealArray:
        """Return the deformations without the elements, (m, n_e, n_c)."""
        n, f, m = self.n_elements, self.fourier, len(self.omega)
        Q = np.zeros((m, n, len(f.harmonics)), dtype=np.complex128)
        Q[:, :, f.first] = self.level[:, None] * self.H[:, f.first, :n, n]
        return self.to_coordinates(Q)

    def grow(self, x: RealArray, at: IndexArray, end: float = 1.0) -> tuple[RealArray, BoolArray]:
        """Return the solutions at lines that a growing force reaches, and whether each was found.

        `x` are the deformations without the elements; `end` is the last share of the force.
        """

        def advance(
            x: RealArray, some: IndexArray, before: RealArray, after: RealArray
        ) -> tuple[RealArray, BoolArray]:
            # The response is proportional to a small level.
            ratio = after / np.where(before > 0.0, before, 1.0)
            return self.solve(x * ratio[:, None, None], at[some], end * after)

        return _follow(x, advance, cut=0.25, least=LINE_BALANCE.least_level_step)

    def scan(
        self, near: RealArray, e: int, known: BoolArray | None = None
    ) -> list[tuple[RealArray, BoolArray]]:
        """Return further solutions by the amplitude of element e, and whether each was found.

        Lines with a `known` solution, (m,), are left out if it seems to be the only one.

        The force that an amplitude requires follows from the describing function of element e, with
        those of the others at the solutions `near`. Where it rises through the level, a solution
        lies near: that of the smallest and that of the largest amplitude are returned.
        """
        n, f, m = self.n_elements, self.fourier, len(self.omega)
        H = self.H[:, f.first]
        Q = self._to_complex(near)[:, :, f.first]
        largest = np.max(np.abs([self.level * np.abs(H[:, e, n]), np.abs(Q[:, e])]))
        grid = largest * np.geomspace(*LINE_BALANCE.scanned, LINE_BALANCE.scan_points)
        others = self.describe(np.maximum(np.abs(Q), np.finfo(np.float64).tiny))
        N = np.repeat(others[:, None], len(grid), axis=1)
        N[:, :, e] = self._describe_grid(e, grid)
        unit = _respond_to_unit(H, N)
        excess = grid / np.maximum(np.abs(unit[:, :, e]), np.finfo(np.float64).tiny)
        rises = (excess[:, :-1] < self.level[:, None]) & (excess[:, 1:] >= self.level[:, None])
        found = []
        first, last = rises.argmax(axis=1), rises.shape[1] - 1 - rises[:, ::-1].argmax(axis=1)
        has_several = rises.sum(axis=1) > 1
        is_sought = rises.any(axis=1) if known is None else rises.any(axis=1) & ~known
        for position, chosen in ((first, is_sought | has_several), (last, has_several)):
            line = np.flatnonzero(chosen)
            if not len(line):
                continue
            at = position[line]
            below, above = np.log(excess[line, at]), np.log(excess[line, at + 1])
            share = (np.log(self.level[line]) - below) / (above - below)
            amplitude = grid[at] * (grid[at + 1] / grid[at]) ** share
            own = N[line, at]
            own[:, e] = self._describe_one(e, amplitude, self.omega[line])
            guess = self.level[line, None] * _respond_to_unit(H[line], own[:, None])[:, 0]
            x, is_solved = near.copy(), np.zeros(m, dtype=np.bool_)
            harmonics = np.zeros((len(line), n, len(f.harmonics)), dtype=np.complex128)
            harmonics[:, :, f.first] = guess
            x[line], is_solved[line] = self.solve(self.to_coordinates(harmonics), line)
            found.append((x, is_solved))
        return found

    def describe(self, amplitudes: RealArray) -> ComplexArray:
        """Return the describing functions over the deformation at amplitudes, (m, n_e)."""
        each = [self._describe_one(e, amplitudes[:, e], self.omega) for e in range(self.n_elements)]
        return np.stack(each, axis=1)

    def _describe_one(self, e: int, amplitudes: RealArray, omega: RealArray) -> ComplexArray:
        """Return the describing function of an element over the deformation, shape (k,)."""
        samples = self.fourier.synthesis.shape[0]
        return describe_first_harmonic(self.elements[e], amplitudes, omega, samples)[0]

    def _describe_grid(self, e: int, grid: RealArray) -> ComplexArray:
        """Return the describing function of an element at each line and amplitude, (m, g)."""
        if self.elements[e].quantity == "receptance":
            once = self._describe_one(e, grid, np.ones(len(grid)))
            return np.asarray(np.broadcast_to(once, (len(self.omega), len(grid))))
        # It is a function of the velocity amplitude, times i omega.
        speeds = self.omega[:, None] * grid
        known = np.geomspace(speeds.min(), speeds.max(), 2 * len(grid))
        once = self._describe_one(e, known, np.ones(len(known)))
        real, imag = (np.interp(speeds, known, part) for part in (once.real, once.imag))
        return np.asarray(self.omega[:, None] * (real + 1j * imag), dtype=np.complex128)

    def find_all(self, near: RealArray | None = None) -> list[tuple[RealArray, BoolArray]]:
        """Return candidates for the solutions at all lines, and whether each is a solution.

        `near` are the solutions of a similar model.
        """
        linear, n = self.linear(), self.n_elements
        x, is_solved = linear.copy(), np.zeros(len(linear), dtype=np.bool_)
        if near is None:
            found = [one for e in range(n) for one in self.scan(linear, e)]
        else:
            x, is_solved = self.solve(near, np.arange(len(near)))
            found = [one for e in range(n) for one in self.scan(x, e, is_solved)]
        for candidate, ok in found:
            first = ok & ~is_solved
            x[first], is_solved[first] = candidate[first], True
        missing = np.flatnonzero(~is_solved)
        x[missing], is_solved[missing] = self.grow(linear[missing], missing)
        x, is_solved = self.fill(x, is_solved)
        for i in np.flatnonzero(~is_solved).tolist():
            turned = self.turn(i)
            if turned is not None:
                x[i], is_solved[i] = turned, True
        if n > 1 and near is None:
            found += [one for e in range(n) for one in self.scan(x, e)]
        return [(x, is_solved), *found]

    def turn(self, line: int) -> RealArray | None:
        """Return the solution at a line on the branch of small forces, through turning points."""
        share, at = LINE_BALANCE.small_share, np.array([line])
        x, is_solved = self.grow(share * self.linear()[at], at, share)
        if not is_solved[0]:
            return None
        found = follow_force(_GrowingLine(self, line), x[0], share)
        return None if found is None else found.x

    def jumps(self, x: RealArray) -> IndexArray:
        """Return the lines before a jump of an amplitude."""
        A = _amplitudes(x)[:, :, 0]
        ratio = np.abs(np.log(A[1:] / A[:-1])).max(axis=1)
        near = np.diff(self.omega) <= LINE_BALANCE.farthest * self.omega[1:]
        return np.flatnonzero((ratio > LINE_BALANCE.jump) & near)

    def move(self, x: RealArray, source: IndexArray, at: IndexArray) -> tuple[RealArray, BoolArray]:
        """Return the solutions at lines that those of other lines lead to, and which were found.

        On the way, the receptances are interpolated between the two lines.
        """

        def advance(
            x: RealArray, some: IndexArray, before: RealArray, after: RealArray
        ) -> tuple[RealArray, BoolArray]:
            between = self._between(source[some], at[some], after)
            return between.solve(x, np.arange(len(some)))

        return _follow(
            x, advance, cut=0.5, least=LINE_BALANCE.least_move, most=LINE_BALANCE.most_moves
        )

    def _between(self, source: IndexArray, at: IndexArray, share: RealArray) -> LineBalance:
        """Return the balance at interpolated lines."""

        def mix(values: NumberArray) -> NumberArray:
            weight = share.reshape(-1, *[1] * (values.ndim - 1))
            mixed: NumberArray = (1.0 - weight) * values[source] + weight * values[at]
            return mixed

        return replace(self, omega=mix(self.omega), level=mix(self.level), H=mix(self.H))

    def fill(self, x: RealArray, is_solved: BoolArray) -> tuple[RealArray, BoolArray]:
        """Return the solutions with those of unsolved lines, as far as neighbours lead to them."""
        x, is_solved = x.copy(), is_solved.copy()
        for direction in (1, -1):
            order = range(len(x))[::direction]
            for i in order[1:]:
                if is_solved[i] or not is_solved[i - direction]:
                    continue
                found, ok = self.move(x[[i - direction]], np.array([i - direction]), np.array([i]))
                if ok[0]:
                    x[i], is_solved[i] = found[0], True
        return x, is_solved

    def respond(self, now: LineEvaluation, at: IndexArray) -> ComplexArray:
        """Return the first harmonic of the responses over the force at the lines `at`, (k, n_i)."""
        n, first = self.n_elements, self.fourier.first
        H = self.H[at, first, n:]
        T = now.forces[:, :, first] / self.level[at, None]
        return np.asarray(H[:, :, n] - np.einsum("mie,me->mi", H[:, :, :n], T))

    def is_stable(self, now: LineEvaluation) -> BoolArray:
        """Return whether the determinant of the Jacobian is above 0, as it is on stable motion."""
        sign, _ = np.linalg.slogdet(now.jacobian)
        return np.asarray(sign > 0.0)

    def derive(
        self, now: LineEvaluation, dH: ComplexArray, places: Sequence[tuple[int, int]]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return derivatives of `respond` by linear unknowns and by parameters of elements.

        `dH` (n_p, m, n_h, ...) are derivatives of H; `places` are the element and the position of
        each parameter. The results are (n_p, m, n_i) and (len(places), m, n_i).
        """
        n, f = self.n_elements, self.fourier
        T, level, m = now.forces, self.level[:, None], len(self.omega)
        direct = np.einsum("pmkef,mfk->pmek", dH[:, :, :, :, :n], T)
        direct[:, :, :, f.first] -= level * dH[:, :, f.first, :, n]
        changed = np.zeros((len(places), m, n, len(f.harmonics)), dtype=np.complex128)
        for i, (e, column) in enumerate(places):
            values = now.periods[e].parameters[:, :, column] @ f.analysis.T
            changed[i, :, e] = self._to_complex(values[:, None])[:, 0]
        by_force = np.einsum("mkef,pmfk->pmek", self.H[:, :, :, :n], changed)
        whole = np.concatenate([direct, by_force])
        moved = -self._solve_many(now.jacobian, whole[:, :, :n])
        tangent = np.stack([self._tangent(one, self.omega) for one in now.periods], axis=1)
        first = self._to_complex(tangent)[:, :, f.first]
        dT = np.einsum("mec,pmec->pme", first, moved)
        read = self.H[:, f.first, n:, :n]
        out = -(whole[:, :, n:, f.first] + np.einsum("mie,pme->pmi", read, dT)) / level
        return out[: len(dH)], out[len(dH) :]

    def _solve_many(self, J: RealArray, right: ComplexArray) -> RealArray:
        """Return J^-1 R at each line, (n_p, m, n_e, n_c), for complex residuals."""
        (p, m), n = right.shape[:2], self.n_elements
        size = J.shape[-1]
        rows = self.to_coordinates(right.reshape(p * m, *right.shape[2:])).reshape(p, m, size)
        X = np.linalg.solve(J, rows.transpose(1, 2, 0))
        return np.asarray(X.transpose(2, 0, 1).reshape(p, m, n, size // n))


@dataclass(frozen=True, slots=True, eq=False)
class DeflatedBalance(LineBalance):
    """The balance times 1 + 1 / d^2 with the distance d from solutions that are known.

    `known` (m, n_e, n_c) has one at each line; d is in amplitudes of its elements. Iterations near
    it lead to another solution (shifted deflation: Farrell, Birkisson & Funke, SIAM J. Sci. Comput.
    37 (2015) A2026).
    """

    known: RealArray

    def _balance(
        self, x: RealArray, at: IndexArray, share: RealArray
    ) -> tuple[RealArray, RealArray, RealArray]:
        R, J, size = LineBalance._balance(self, x, at, share)
        known = self.known[at]
        scale = _amplitudes(known)
        y = ((x - known) / scale).reshape(len(at), -1)
        d2 = np.maximum(np.sum(y**2, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        slope = -2.0 * y / d2**2 / np.broadcast_to(scale, x.shape).reshape(y.shape)
        factor = 1.0 + 1.0 / d2
        J = factor[:, :, None] * J + R[:, :, None] * slope[:, None, :]
        return factor * R, J, factor[:, 0] * size


@dataclass(frozen=True, slots=True, eq=False)
class _GrowingLine:
    """The balance at one line; the parameter is the share of the force."""

    balance: LineBalance
    line: int

    least: ClassVar[float] = -np.inf

    def evaluate(self, x: RealArray, omega: float) -> Evaluation:
        """Return the balance at the share `omega` of the force."""
        b, f, at = self.balance, self.balance.fourier, np.array([self.line])
        now, n = b.evaluate(x[None], at, omega), b.n_elements
        unit = np.zeros((n, len(f.harmonics)), dtype=np.complex128)
        unit[:, f.first] = b.level[self.line] * b.H[self.line, f.first, :n, n]
        return Evaluation(
            x, omega, now.residual[0], now.jacobian[0], -f.to_real(unit), now.forces[0], ()
        )


def _follow(
    x: RealArray,
    advance: Callable[[RealArray, IndexArray, RealArray, RealArray], tuple[RealArray, BoolArray]],
    *,
    cut: float,
    least: float,
    most: int | None = None,
) -> tuple[RealArray, BoolArray]:
    """Return the solutions of k paths from share 0 to 1, and which of them reached the end.

    `advance` solves some paths from their shares to others. Where it fails, the step is multiplied
    by `cut`, down to `least`; there are `most` steps.
    """
    x = x.copy()
    reached, step = np.zeros(len(x)), np.ones(len(x))
    active = np.arange(len(x))
    for _ in itertools.count() if most is None else range(most):
        if not len(active):
            break
        before = reached[active]
        after = np.minimum(before + step[active], 1.0)
        found, ok = advance(x[active], active, before, after)
        hit = active[ok]
        x[hit], reached[hit] = found[ok], after[ok]
        step[active[~ok]] *= cut
        active = active[(reached[active] < 1.0) & (step[active] >= least)]
    return x, reached >= 1.0


def _amplitudes(x: RealArray) -> RealArray:
    """Return the amplitude of each element, (m, n_e, 1), above 0."""
    return np.maximum(np.linalg.norm(x, axis=2, keepdims=True), np.finfo(np.float64).tiny)


def _respond_to_unit(H: ComplexArray, N: ComplexArray) -> ComplexArray:
    """Return deformations per force, (k, g, n_e), with elements of the stiffness N, (k, g, n_e)."""
    n = N.shape[2]
    J = np.eye(n) + H[:, None, :n, :n] * N[:, :, None, :]
    right = np.broadcast_to(H[:, None, :n, n, None], (*N.shape, 1))
    return np.asarray(np.linalg.solve(J, right)[..., 0])


def _solve_each(J: RealArray, right: RealArray) -> RealArray:
    """Return the solution at each line; infinite where J is singular."""
    try:
        return np.asarray(np.linalg.solve(J, right[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        out = np.full_like(right, np.inf)
        for i, (matrix, r) in enumerate(zip(J, right, strict=True)):
            try:
                out[i] = np.linalg.solve(matrix, r)
            except np.linalg.LinAlgError:
                continue
        return out
