"""`Approximation`: a rational approximation of the damped response, with relative weights.

Vector fitting (Gustavsen & Semlyen 1999, see `updyn.modal.vector_fitting`) places the poles of all
channels at once, each line divided by its level. Weights increase at the lines with the largest
errors (C. L. Lawson 1961; G. R. Ellis & J. R. Rice, SIAM J. Numer. Anal. 5 (1968) 1-10), so the
largest error decreases instead of the mean square. For several inputs, Gauss-Newton steps refine
all parameters. Last, linear least squares fit the outputs and keep collocated channels passive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg

from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.control.passivity import active_part, constrained_least_squares, violations
from updyn.control.rational import Rational, SlowMotion, states_of_poles
from updyn.control.settings import PASSIVITY, RATIONAL_FIT
from updyn.control.space import laplace_variable
from updyn.control.target import ResponseTarget
from updyn.modal.vector_fitting import RationalBasis, compute_sigma_zeros, stack_equations

__all__ = ["Approximation"]


_BASIS = RationalBasis(0, mirrored=True)
_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Approximation:
    """The response to approximate, and the initial poles above the real axis, in rad/s.

    `slow` is kept exactly. `poles` are by decreasing importance. `collocated` are the channels
    (output, input) that stay passive. `weight`, shape (n_f, n_y, n_u), is by default the reciprocal
    of `level`. `powers` are 0, 1, 2 for displacement, velocity, acceleration.
    """

    target: ResponseTarget
    slow: SlowMotion
    powers: IndexArray
    poles: ComplexArray
    collocated: Sequence[tuple[int, int]]
    weight: RealArray | None = None
    known: ComplexArray = field(init=False)

    def __post_init__(self) -> None:
        s = laplace_variable(self.target.freq)
        object.__setattr__(self, "known", self.slow.response(s, self.powers))
        if self.weight is None:
            object.__setattr__(self, "weight", 1.0 / self.level)

    @property
    def level(self) -> RealArray:
        """Reference magnitude of relative errors, shape (n_f, n_y, n_u)."""
        target = self.target
        if target.measure == "relative":
            return target.reference
        return np.broadcast_to(target.level, target.reference.shape)

    @property
    def unit(self) -> float:
        """Circular frequency that scales the poles in the fit."""
        return _TWO_PI * float(self.target.freq[-1])

    @property
    def slowest(self) -> float:
        """Smallest modulus of a pole in rad/s: the first line above 0 Hz, in a band from 0 Hz."""
        # A slower pole would act as an integrator at all lines except 0 Hz, where it has a finite
        # gain; no line would show its response between them.
        freq = self.target.freq
        return 0.0 if freq[0] > 0.0 else _TWO_PI * float(freq[1])

    def initial_poles(self, n: int) -> tuple[ComplexArray, RealArray]:
        """Return initial pairs and initial rates of real poles for n states."""
        count = n // 2
        pairs = self.poles[:count]
        if len(pairs) < count:
            low = max(self.target.freq[0], 1e-3 * self.target.freq[-1]) * _TWO_PI
            free = np.geomspace(low, self.unit, 2 * (count - len(pairs)) + 1)[1::2]
            damping = RATIONAL_FIT.free_damping
            free = free * (-damping + 1j * np.sqrt(1.0 - damping**2))
            pairs = np.concatenate([pairs, free])
        rates = np.full(n % 2, 0.3 * self.unit)
        return pairs, rates

    def fit(self, n: int, tolerance: float) -> Rational:
        """Return the approximation with n more states than the slow ones, refined if promising."""
        pairs, rates = self.initial_poles(n)
        assert self.weight is not None
        weight = self.weight
        if n:
            pairs, rates, weight, residues = self._relocate_poles(pairs, rates, tolerance)
            right = self._input_vectors(pairs, rates, residues)
        else:
            right = np.zeros((self.target.values.shape[2], 0), dtype=np.complex128)
        if min(self.target.values.shape[1:]) > 1 and right.size:
            pairs, rates, right = self._refine(
                pairs, rates, right, weight, RATIONAL_FIT.newton_steps
            )
        return self._fit_all_outputs(pairs, rates, right, weight, tolerance)

    def refit(self, like: Rational, tolerance: float, steps: int) -> Rational:
        """Return the approximation with the poles and vectors b of a similar one, refined.

        Its poles first move with those of the structure; then `steps` Gauss-Newton steps follow (0
        for a single input or output).
        """
        assert self.weight is not None
        weight = self.weight
        pairs, rates, right = self._move_pairs(like), like.rates, like.right
        if steps:
            pairs, rates, right = self._refine(pairs, rates, right, weight, steps)
        return self._fit_all_outputs(pairs, rates, right, weight, tolerance)

    def _move_pairs(self, like: Rational) -> ComplexArray:
        """Return the pairs of another approximation, moved with the poles of the structure."""
        pairs = like.pairs.copy()
        if not len(self.poles):
            return pairs
        for j in np.flatnonzero(np.isfinite(like.structure)):
            pole = like.structure[j]
            pairs[j] += self.poles[np.argmin(np.abs(self.poles - pole))] - pole
        return np.where(pairs.real < 0.0, pairs, like.pairs)

    def _nearest_poles(self, pairs: ComplexArray) -> ComplexArray:
        """Return the nearest pole of the structure for each pair; nan if none is near."""
        if not len(self.poles):
            return np.full(len(pairs), np.nan, dtype=np.complex128)
        nearest = self.poles[np.argmin(np.abs(pairs[:, None] - self.poles), axis=1)]
        near = np.abs(pairs - nearest) <= RATIONAL_FIT.match_distance * np.abs(pairs)
        return np.where(near, nearest, np.nan)

    # -- poles ----------------------------------------------------------------------------------
    def _relocate_poles(
        self, pairs: ComplexArray, rates: RealArray, tolerance: float
    ) -> tuple[ComplexArray, RealArray, RealArray, ComplexArray]:
        """Return poles, weights and residues (m + k, n_y, n_u) of the best vector fit."""
        x = laplace_variable(self.target.freq) / self.unit
        poles = np.asarray(np.concatenate([pairs, -rates]) / self.unit, dtype=np.complex128)
        shape = self.target.values.shape
        Y = (self.target.values - self.known).reshape(len(x), -1)
        level = self.level.reshape(len(x), -1)
        assert self.weight is not None
        W = first = self.weight.reshape(len(x), -1)
        powers = np.repeat(self.powers, shape[2])
        best: tuple[float, Any] = (np.inf, None)
        # For several inputs, poles and vectors are refined together afterwards.
        following = RATIONAL_FIT.weighted_iterations if min(shape[1:]) == 1 else 0
        unweighted = RATIONAL_FIT.pole_iterations
        for number in range(unweighted + following):
            poles = _fit_poles(x, Y, W, poles, powers, bool(len(self.slow.velocities)))
            poles = poles * _move_outwards(np.abs(poles), self.slowest / self.unit)
            found, residues = _residues(x, Y, W, poles, powers, bool(len(self.slow.velocities)))
            error = np.abs(found - Y) / level
            if error.max() < best[0]:
                best = float(error.max()), (poles, W, residues)
            if number == unweighted - 1 and best[0] > RATIONAL_FIT.refined_error * tolerance:
                break
            if number >= unweighted - 1:
                W = W * _weight_factors(error)
                W = W / (W / first).max()
        poles, W, residues = best[1]
        pair = poles.imag > 0
        order = np.argsort(~pair, kind="stable")
        residues = residues[order].reshape(len(poles), *shape[1:])
        return (
            poles[pair] * self.unit,
            -poles[~pair].real * self.unit,
            W.reshape(shape),
            residues * self.unit,
        )

    def _input_vectors(
        self, pairs: ComplexArray, rates: RealArray, residues: ComplexArray
    ) -> ComplexArray:
        """Return the vectors b of the nearest residues of rank one, shape (n_u, n)."""
        n_u = residues.shape[2]
        poles = np.concatenate([np.abs(pairs), rates])
        if n_u == 1:
            return np.asarray(poles[None] + 0j)
        at = np.searchsorted(_TWO_PI * self.target.freq, poles).clip(max=len(self.target.freq) - 1)
        out = np.empty((n_u, len(poles)), dtype=np.complex128)
        for k, R in enumerate(residues):
            size = np.maximum(self.level[at[k]], 1e-300)
            rows = np.exp(np.mean(np.log(size), axis=1))
            columns = np.exp(np.mean(np.log(size), axis=0))
            scaled: NumberArray = R / rows[:, None] / columns
            if k >= len(pairs):
                scaled = scaled.real
            out[:, k] = np.linalg.svd(scaled)[2][0] * columns
            out[:, k] *= poles[k] / max(float(np.abs(out[:, k]).max()), 1e-300)
        return out

    def _refine(
        self,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        weight: RealArray,
        steps: int,
    ) -> tuple[ComplexArray, RealArray, ComplexArray]:
        """Return poles and vectors b after damped Gauss-Newton steps, outputs eliminated."""
        current = self._fit_least_squares(pairs, rates, right, weight)
        cost, damping = self._cost(current, weight), 1e-3
        for _ in range(steps):
            J, r = self._jacobian(current, weight)
            scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
            J = J / scale
            normal, gradient = J.T @ J, J.T @ r
            for _ in range(4):
                step = np.linalg.solve(normal + damping * np.eye(len(normal)), gradient) / scale
                candidate = self._take_step(current, step, weight)
                new = self._cost(candidate, weight)
                if new < cost:
                    break
                damping *= 10.0
            else:
                break
            gained = cost - new
            current, cost, damping = candidate, new, 0.2 * damping
            if gained < 1e-4 * cost:
                break
        return current.pairs, current.rates, current.right

    def _cost(self, found: Rational, weight: RealArray) -> float:
        G = found.response(found.always_kept, self.target.freq)
        return float(np.sum((np.abs(G - self.target.values) * weight) ** 2))

    def _jacobian(self, found: Rational, weight: RealArray) -> tuple[RealArray, RealArray]:
        """Return derivatives by poles and vectors b, outputs eliminated, and the residual."""
        s = laplace_variable(self.target.freq)
        m, k = len(found.pairs), len(found.rates)
        n_f, n_y, n_u = self.target.values.shape
        c = 0.5 * (found.rows[:, : 2 * m : 2] + 1j * found.rows[:, 1 : 2 * m : 2])
        columns: list[ComplexArray] = []
        b: NumberArray
        for j in range(m):
            p, b, output_vector = found.pairs[j], found.right[:, j], c[:, j]
            up = np.asarray(1.0 / (s - p), dtype=np.complex128)
            down = np.asarray(1.0 / (s - p.conj()), dtype=np.complex128)
            R = np.outer(output_vector, b)
            a = np.multiply.outer(up**2, R), np.multiply.outer(down**2, R.conj())
            columns += [p.real * (a[0] + a[1]), abs(p) * 1j * (a[0] - a[1])]
            for u in range(n_u):
                one = np.zeros((2, n_f, n_y, n_u), dtype=np.complex128)
                one[0, :, :, u], one[1, :, :, u] = (
                    np.outer(up, output_vector),
                    np.outer(down, output_vector.conj()),
                )
                columns += [abs(p) * (one[0] + one[1]), abs(p) * 1j * (one[0] - one[1])]
        for j in range(k):
            rate, b, row = found.rates[j], found.right[:, m + j].real, found.rows[:, 2 * m + j]
            real = 1.0 / (s + rate)
            columns.append(-rate * np.multiply.outer(real**2, np.outer(row, b)))
            for u in range(n_u):
                single = np.zeros((n_f, n_y, n_u), dtype=np.complex128)
                single[:, :, u] = rate * np.outer(real, row)
                columns.append(single)
        error = self.target.values - found.response(found.always_kept, self.target.freq)
        parts = []
        for i in range(n_y):
            known = _weighted_columns(
                self._basis_functions(s, found.pairs, found.rates, found.right, i), weight, i
            )
            Q = np.linalg.qr(known)[0]
            w = weight[:, i]
            own_J = np.stack([(column[:, i] * w).ravel() for column in columns], axis=1)
            own_r = (error[:, i] * w).ravel()[:, None]
            whole = _BASIS.parts(np.hstack([own_J, own_r]))
            parts.append(whole - Q @ (Q.T @ whole))
        stack = np.vstack(parts)
        return stack[:, :-1], stack[:, -1]

    def _take_step(self, found: Rational, step: RealArray, weight: RealArray) -> Rational:
        """Return the approximation after a step of poles and vectors b, with fitted outputs."""
        m, n_u = len(found.pairs), len(found.right)
        width = 2 + 2 * n_u
        pole_steps = step[: width * m].reshape(m, width)
        size = np.abs(found.pairs)
        decay = np.clip(pole_steps[:, 0], -1.0, 1.0)
        pairs = found.pairs.real * np.exp(decay) + 1j * np.maximum(
            found.pairs.imag + size * np.clip(pole_steps[:, 1], -0.1, 0.1), 1e-6 * size
        )
        right = found.right.copy()
        right[:, :m] += (size[:, None] * (pole_steps[:, 2::2] + 1j * pole_steps[:, 3::2])).T
        real = step[width * m :].reshape(len(found.rates), 1 + n_u)
        rates = found.rates * np.exp(np.clip(real[:, 0], -1.0, 1.0))
        right[:, m:] += (found.rates[:, None] * real[:, 1:]).T
        pairs = pairs * _move_outwards(np.abs(pairs), self.slowest)
        rates = rates * _move_outwards(rates, self.slowest)
        return self._fit_least_squares(pairs, rates, right, weight)

    # -- outputs --------------------------------------------------------------------------------
    def _basis_functions(
        self,
        s: ComplexArray,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        output: int,
    ) -> ComplexArray:
        """Return the basis functions of an output, shape (n_f, k, n_u)."""
        states = states_of_poles(s, pairs, rates, right)
        power, n_u = self.powers[output], right.shape[0]
        rest = states_of_poles(np.zeros(1, dtype=np.complex128), pairs, rates, right)
        if power == 2:
            return states - rest
        if power == 1:
            return states
        still = self.slow.B[self.slow.velocities] / s[:, None, None]
        eye = np.broadcast_to(np.eye(n_u), (len(s), n_u, n_u))
        return np.concatenate([states, still, eye], axis=1)

    def _admissible_coefficients(
        self, pairs: ComplexArray, rates: RealArray, right: ComplexArray, output: int
    ) -> tuple[RealArray, RealArray]:
        """Return a particular solution and a basis of the admissible coefficients of an output."""
        # Velocities without rigid-body motion are 0 at s = 0 and have no feed-through.
        n = 2 * len(pairs) + len(rates)
        if self.powers[output] == 0:
            n += len(self.slow.velocities) + right.shape[0]
        if self.powers[output] != 1 or len(self.slow.velocities):
            return np.zeros(n), np.eye(n)
        rest = states_of_poles(np.zeros(1, dtype=np.complex128), pairs, rates, right)[0].real.T
        jump = (self.slow.displacements @ self.slow.B)[output]
        start = np.linalg.lstsq(rest, jump, rcond=None)[0]
        return start, scipy.linalg.null_space(rest)

    def _fit_least_squares(
        self, pairs: ComplexArray, rates: RealArray, right: ComplexArray, weight: RealArray
    ) -> Rational:
        s = laplace_variable(self.target.freq)
        found = []
        for i in range(len(self.powers)):
            found.append(self._fit_output(s, pairs, rates, right, weight, i, None))
        return self._assemble(pairs, rates, right, [x for x in found if x is not None])

    def _fit_output(
        self,
        s: ComplexArray,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        weight: RealArray,
        output: int,
        passive_at: RealArray | None,
        columns: ComplexArray | None = None,
    ) -> RealArray | None:
        """Return the coefficients of an output, passive at some frequencies in rad/s; else None."""
        power = self.powers[output]
        if columns is None:
            columns = self._basis_functions(s, pairs, rates, right, output)
        known = self.known[:, output]
        offset, free = self._admissible_coefficients(pairs, rates, right, output)
        A = _weighted_columns(columns, weight, output) @ free
        wanted = self.target.values[:, output] - known
        b = _BASIS.parts((wanted * weight[:, output]).ravel()[:, None])[:, 0]
        b = b - _weighted_columns(columns, weight, output) @ offset
        if passive_at is None:
            scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
            return np.asarray(offset + free @ (_least_squares(A / scale, b) / scale))
        rows, bounds = [], []
        for o, u in self.collocated:
            if o != output:
                continue
            at = np.asarray(1j * passive_at, dtype=np.complex128)
            base = self.slow.response(at, self.powers)[:, o, u]
            passive_columns = self._basis_functions(at, pairs, rates, right, o)
            size = np.maximum(np.abs(passive_columns[:, :, u]).max(axis=1), 1e-300)
            part = active_part(passive_columns[:, :, u], int(power))
            rows.append(part @ free / size[:, None])
            level = np.abs(base) + np.interp(
                passive_at, _TWO_PI * self.target.freq, np.abs(self.target.values[:, o, u])
            )
            bound = PASSIVITY.margin * level - active_part(base, int(power)) - part @ offset
            bounds.append(bound / size)
            if power == 0:  # residual flexibility yields in the direction of the force
                through = np.zeros((1, columns.shape[1]))
                through[0, columns.shape[1] - right.shape[0] + u] = 1.0
                rows.append(through @ free)
                bounds.append(-(through @ offset))
        x = constrained_least_squares(A, b, np.vstack(rows), np.concatenate(bounds))
        return None if x is None else offset + free @ x

    def _fit_all_outputs(
        self,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        weight: RealArray,
        tolerance: float,
    ) -> Rational:
        """Return the approximation with the smallest maximum error, collocated channels passive."""
        s = laplace_variable(self.target.freq)
        assert self.weight is not None
        found: list[RealArray] = []
        for i in range(len(self.powers)):
            columns = self._basis_functions(s, pairs, rates, right, i)
            at: RealArray | None = None
            best = self._equalise_errors(s, pairs, rates, right, weight, i, at, columns, tolerance)
            channels = [u for o, u in self.collocated if o == i]
            for _ in range(PASSIVITY.iterations if channels else 0):
                rows = [np.zeros(columns.shape[1])] * len(self.powers)
                rows[i] = best
                matrices = self._assemble(pairs, rates, right, rows, only=i).matrices(
                    np.zeros(0, bool)
                )
                worst = []
                for u in channels:
                    A, B, C, D = matrices
                    one = A, B[:, [u]], C[[i]], D[[i]][:, [u]]
                    worst.append(violations(one, int(self.powers[i])))
                new = np.concatenate(worst)
                # The flexibility of a constrained fit is not negative, except for rounding.
                is_constrained = self.powers[i] != 0 or at is not None
                if not len(new) and (is_constrained or (matrices[3][i, channels] >= 0.0).all()):
                    break
                about = np.multiply.outer(new, np.array([0.8, 0.95, 1.0, 1.05, 1.25])).ravel()
                at = about if at is None else np.concatenate([at, about])
                tried = self._equalise_errors(
                    s, pairs, rates, right, weight, i, at, columns, tolerance
                )
                if tried is None:
                    break
                best = tried
            found.append(best)
        return self._assemble(pairs, rates, right, found)

    def _equalise_errors(
        self,
        s: ComplexArray,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        weight: RealArray,
        output: int,
        at: RealArray | None,
        columns: ComplexArray,
        tolerance: float,
    ) -> Any:
        """Return the coefficients of an output after iterations with updated weights."""
        level = self.level[:, output]
        W = weight.copy()
        best, least = None, np.inf
        for _ in range(RATIONAL_FIT.output_iterations):
            x = self._fit_output(s, pairs, rates, right, W, output, at, columns)
            if x is None:
                break
            G = self.known[:, output] + np.einsum("k,fku->fu", x, columns)
            error = np.abs(G - self.target.values[:, output]) / level
            if error.max() < least:
                best, least = x, float(error.max())
            if best is not None and least > RATIONAL_FIT.refined_error * tolerance:
                break
            W[:, output] = W[:, output] * _weight_factors(error)
        return best

    def _assemble(
        self,
        pairs: ComplexArray,
        rates: RealArray,
        right: ComplexArray,
        found: Sequence[RealArray],
        only: int | None = None,
    ) -> Rational:
        n, n_u, still = 2 * len(pairs) + len(rates), right.shape[0], len(self.slow.velocities)
        n_y = len(self.powers)
        rows, drift, through = np.zeros((n_y, n)), np.zeros((n_y, still)), np.zeros((n_y, n_u))
        rest = states_of_poles(np.zeros(1, dtype=np.complex128), pairs, rates, right)[0].real
        for i, power in enumerate(self.powers):
            if only is not None and i != only:
                continue
            rows[i] = found[i][:n]
            if power == 0:
                drift[i], through[i] = found[i][n : n + still], found[i][n + still :]
            elif power == 2:
                through[i] = -found[i][:n] @ rest
        parts = pairs, rates, right, rows, drift, through, self._nearest_poles(pairs)
        return Rational(self.slow, self.powers, *parts)


def _move_outwards(size: RealArray, least: float) -> RealArray:
    """Return factors that move poles below a modulus out to it."""
    return np.maximum(1.0, least / np.maximum(size, 1e-300))


def _weight_factors(error: RealArray) -> RealArray:
    """Return factors of the weights in one iteration, by the error of each value."""
    share = error / max(error.max(), 1e-300)
    return np.asarray(np.sqrt(RATIONAL_FIT.least_weight + share))


def _weighted_columns(columns: ComplexArray, weight: RealArray, output: int) -> RealArray:
    """Return weighted equations with real coefficients, shape (2 n_f n_u, k)."""
    n_f, k, n_u = columns.shape
    A = (columns * weight[:, output][:, None, :]).transpose(0, 2, 1).reshape(n_f * n_u, k)
    return np.asarray(_BASIS.parts(A))


def _least_squares(A: RealArray, b: RealArray) -> RealArray:
    """Return a least-squares solution by pivoted QR, which is faster than an SVD."""
    least = RATIONAL_FIT.singular_share
    found = scipy.linalg.lstsq(A, b, cond=least, lapack_driver="gelsy", check_finite=False)
    return np.asarray(found[0])


def _numerators(
    x: ComplexArray, inner: ComplexArray, rest: ComplexArray, power: int, still: bool
) -> ComplexArray:
    """Return the basis functions of a channel without rigid-body motion."""
    if power == 0:
        extra = [np.ones((len(x), 1), dtype=np.complex128)]
        if still:
            extra.append(1.0 / x[:, None])
        return np.hstack([inner, *extra])
    if power == 1:
        return inner
    return np.asarray(inner - rest)


def _fit_poles(
    x: ComplexArray,
    Y: ComplexArray,
    W: RealArray,
    poles: ComplexArray,
    powers: IndexArray,
    still: bool,
) -> ComplexArray:
    """Return the poles after one iteration of vector fitting with a weight for each value."""
    inner = _BASIS.fractions(x, poles)
    rest = _BASIS.fractions(np.zeros(1, dtype=np.complex128), poles)
    sigma = np.hstack([inner, np.ones((len(x), 1))])
    triangle = np.zeros((0, sigma.shape[1]))
    for j, power in enumerate(powers):
        w = W[:, [j]]
        Q = np.linalg.qr(_BASIS.parts(_numerators(x, inner, rest, int(power), still) * w))[0]
        triangle = stack_equations(triangle, _BASIS.parts(w * Y[:, [j]] * sigma), Q)
    try:
        return compute_sigma_zeros(_BASIS, x, poles, triangle)
    except (np.linalg.LinAlgError, ValueError):  # two poles coincide
        return poles


def _residues(
    x: ComplexArray,
    Y: ComplexArray,
    W: RealArray,
    poles: ComplexArray,
    powers: IndexArray,
    still: bool,
) -> tuple[ComplexArray, ComplexArray]:
    """Return the fit with given poles, shape (n_f, p), and its residues, shape (k, p)."""
    inner = _BASIS.fractions(x, poles)
    rest = _BASIS.fractions(np.zeros(1, dtype=np.complex128), poles)
    found = np.empty_like(Y)
    out = np.empty((len(poles), Y.shape[1]), dtype=np.complex128)
    for j, power in enumerate(powers):
        columns = _numerators(x, inner, rest, int(power), still)
        A = _BASIS.parts(columns * W[:, [j]])
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        b = _BASIS.parts((W[:, j] * Y[:, j])[:, None])[:, 0]
        weights = _least_squares(A / scale, b) / scale
        found[:, j] = columns @ weights
        out[:, j] = _BASIS.residues(weights, poles)
    return found, out
