"""Model error in the standard deviations: a discrepancy estimated together with the unknowns.

The unknowns compensate a part of the errors in other quantities; that part is not in the residual.
A statistical model of the errors includes it (Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425);
here the errors are local changes of the dynamic stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.errors import SolverError
from updyn.updating.fit.method import Fit
from updyn.updating.fit.null_space import complement
from updyn.updating.fit.settings import NULL_SPACE
from updyn.updating.judge.settings import DISCREPANCY
from updyn.updating.problem.local import Local, join_locals
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual, OutputErrorSet, reduce_residual
from updyn.updating.problem.session import Record

__all__ = ["Discrepancy", "LocalErrors", "estimate_discrepancy", "estimate_local_errors"]


#: Number of changes at each degree of freedom: stiffness, loss, viscous damping and mass.
_KINDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """Contribution of model errors to the uncertainty of the unknowns.

    In the optimiser's coordinates, `covariance`, shape (n, n), is the mean square error: the square
    of `shift` (mean of true value minus estimate) plus its covariance. `share` is of the sum of
    squares of the residual; `gain` is the increase of the restricted log-likelihood.
    """

    covariance: RealArray
    shift: RealArray
    share: float
    gain: float

    def lacks_interval(self, spread: RealArray) -> BoolArray:
        """Return which determined unknowns have no valid interval, shape (n,).

        Their standard deviation is above half of the limit up to which the first order holds.
        `spread` is the covariance due to noise; inf for undetermined unknowns.
        """
        with np.errstate(invalid="ignore"):
            std = np.sqrt(np.diag(spread) + np.diag(self.covariance))
        return np.isfinite(np.diag(spread)) & (std > 0.5 * NULL_SPACE.undetermined_std)


def estimate_discrepancy(
    problem: Problem,
    fit: Fit,
    residual: OutputErrorSet,
    undetermined: RealArray,
    *,
    size_known: bool,
    least_gain: float,
) -> Discrepancy | None:
    """Estimate the model errors in a residual and their effect; None without any, or with modes."""
    # r = J d + B z + e, with the effects B of a spring, a loss, a dashpot and a mass at single
    # DOFs, scaled to equal norm, and normal z of common variance. Both variances maximise the
    # restricted likelihood (Patterson & Thompson, Biometrika 58 (1971) 545). The prior of the
    # shift d has the standard deviation of an undetermined direction, the limit of the first
    # order. If `size_known`, the noise is a lower limit.
    if problem.modal or not problem.parts:
        return None
    weight, within = problem.coordinates.prior[1], complement(undetermined)
    if fit.regularisation is not None:
        weight = weight + fit.regularisation.weight
        within = within if fit.regularisation.within is None else fit.regularisation.within
    try:
        linear = _Linearised.of(problem, fit.x, residual, within)
    except SolverError:
        return None
    if linear is None:
        return None
    prior_rows = _prior_rows(weight, within)
    discrepancy = linear.components.estimate(1.0 if size_known else 0.0, prior_rows)
    if discrepancy.gain < least_gain or discrepancy.share <= 0.0:
        return None
    return replace(
        discrepancy,
        shift=within @ discrepancy.shift,
        covariance=within @ discrepancy.covariance @ within.T,
    )


def estimate_local_errors(
    problem: Problem,
    x: RealArray,
    residual: OutputErrorSet,
    undetermined: RealArray,
    *,
    size_known: bool,
) -> LocalErrors | None:
    """Return the model errors in a residual as local changes; None without an effect of any."""
    within = complement(undetermined)
    linear = _Linearised.of(problem, x, residual, within)
    if linear is None:
        return None
    prior_rows = _prior_rows(problem.coordinates.prior[1], within)
    noise, mean, root = linear.components.locate(1.0 if size_known else 0.0, prior_rows)
    return LocalErrors(within, linear.dofs, linear.norms, mean, root, noise)


@dataclass(frozen=True, slots=True, eq=False)
class LocalErrors:
    """Model errors as local changes of the dynamic stiffness, with the shift of the unknowns.

    `mean`, shape (m + k,), and `root` R of the covariance R R^T, shape (m + k, m + k), are of the m
    effective changes at `dofs` (by part), in units of 1 / `norms`, followed by those of the shift
    `within` the k determined combinations. `noise` is the variance of the noise in the unit of the
    residual. The shift compensates the changes where the structure was measured, so that only both
    together predict elsewhere.
    """

    within: RealArray
    dofs: tuple[IndexArray, ...]
    norms: RealArray
    mean: RealArray
    root: RealArray
    noise: float

    def mean_square(
        self, part: FRFPart, x: RealArray, test: int, matrix: RealArray | None = None
    ) -> RealArray:
        """Return the mean squares of the error of H, shape (3, n_f, n_i, n_j).

        They are those of real part and imaginary part, and of the product of both, for any lines,
        responses and references of a test; of a `matrix` times the responses if it is given.
        """
        effects = _LocalErrors(np.ones(part.frf.values.shape), self.dofs[test])
        n, is_effective = len(self.within), self.norms > 0.0
        found = []
        for lines in effects.partition(part):
            J = effects.on(part, lines).block(part, x, lines)[1]
            if matrix is not None:
                J = np.einsum("ri,kfij->kfrj", matrix, J)
            changes = J[n:][is_effective] / self.norms[is_effective][:, None, None, None]
            both = np.concatenate([changes, np.tensordot(self.within.T, J[:n], axes=1)])
            # The mean is one more column: the mean square is its square plus the variance.
            columns = np.column_stack([self.root, self.mean]).T
            error = np.tensordot(columns, both, axes=1)
            real, imag = error.real, error.imag
            found.append(np.array([np.sum(a, axis=0) for a in (real**2, imag**2, real * imag)]))
        return np.concatenate(found, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """A residual, linear in the unknowns and in local changes at `dofs` of each part.

    `norms` of the changes are 0 for those without an effect.
    """

    components: _Components
    dofs: tuple[IndexArray, ...]
    norms: RealArray

    @classmethod
    def of(
        cls, problem: Problem, x: RealArray, residual: OutputErrorSet, within: RealArray
    ) -> _Linearised | None:
        """Linearise a residual at x; None without effective changes or determined unknowns."""
        dofs, n = _choose_dofs(problem), problem.n
        local = _reduce_with_errors(problem, x, residual, dofs)
        norms = np.linalg.norm(local.R[:, n:], axis=0)
        is_effective = norms > DISCREPANCY.negligible_effect * norms.max(initial=0.0)
        rest = max(2.0 * local.cost - float(local.q @ local.q), 0.0)
        numbers = 2 * problem.n_values - within.shape[1]
        B = local.R[:, n:][:, is_effective] / norms[is_effective]
        components = _Components.of(local.R[:, :n] @ within, B, local.q, rest, numbers)
        if components is None:
            return None
        return cls(components, tuple(dofs), np.where(is_effective, norms, 0.0))


def _prior_rows(weight: RealArray, within: RealArray) -> RealArray:
    """Return the rows of the prior of the shift, over their standard deviations, shape (n, k)."""
    return np.asarray(np.hypot(weight, 1.0 / NULL_SPACE.undetermined_std)[:, None] * within)


@dataclass(frozen=True, slots=True, eq=False)
class _Components:
    """The residual in coordinates in which both variances are diagonal."""

    #: Norms of the columns of J, shape (k,).
    norms: RealArray
    #: Triangle of J with unit columns, shape (k, k).
    head: RealArray
    #: Components of the changes in the range of J, shape (k, m).
    effects: RealArray
    #: Right singular vectors of the effects orthogonal to J, shape (r, m).
    V: RealArray
    #: Singular values of these effects, shape (r,).
    s: RealArray
    #: The residual along their left singular vectors, shape (r,).
    h: RealArray
    #: Sum of squares of the residual orthogonal to J and to all effects.
    rest: float
    #: Number of real values minus number of unknowns.
    numbers: int

    @classmethod
    def of(
        cls, J: RealArray, B: RealArray, r: RealArray, rest: float, numbers: int
    ) -> _Components | None:
        """Reduce the stacked problem; None if J is rank-deficient or the residual is zero."""
        k, norms = J.shape[1], np.linalg.norm(J, axis=0)
        if k == 0 or B.shape[1] == 0 or numbers <= 0 or not norms.all():
            return None
        R = np.linalg.qr(np.column_stack([J / norms, B, r]), mode="r")
        head, effects, below = R[:k, :k], R[:k, k:-1], R[k:, k:-1]
        if np.abs(np.diag(head)).min() < DISCREPANCY.negligible_effect:
            return None
        U, s, V = np.linalg.svd(below, full_matrices=False)
        h = U.T @ R[k:, -1]
        rest += max(float(R[k:, -1] @ R[k:, -1] - h @ h), 0.0)
        if s.max(initial=0.0) == 0.0 or rest + float(h @ h) == 0.0:
            return None
        return cls(norms, head, effects, V, s, h, rest, numbers)

    def estimate(self, least: float, prior_rows: RealArray) -> Discrepancy:
        """Return the discrepancy at the maximum of the restricted likelihood.

        `least` is the least noise variance; `prior_rows` (p, k) are divided by their standard
        deviations.
        """
        ratio = self._find_ratio(least)
        noise, share = self._noise(ratio, least), np.exp(ratio) * self.s**2
        total = self.rest + float(self.h @ self.h)
        remaining = self.rest + float(np.sum((self.h / (1.0 + share)) ** 2))
        gain = float(self._cost(-np.inf, least) - self._cost(ratio, least))
        shift, spread = self._shift(noise, noise * np.exp(ratio), prior_rows)
        covariance = spread + np.outer(shift, shift)
        return Discrepancy(covariance, shift, max(1.0 - remaining / total, 0.0), gain)

    def locate(self, least: float, prior_rows: RealArray) -> tuple[float, RealArray, RealArray]:
        """Return the variance of the noise, and mean and root of the changes and the shift."""
        ratio = self._find_ratio(least)
        noise = self._noise(ratio, least)
        triangle, mean = self._solve(noise, noise * np.exp(ratio), prior_rows)
        root = scipy.linalg.solve_triangular(triangle, np.eye(len(mean)))
        unit = np.append(np.ones(len(mean) - len(self.norms)), self.norms)
        return noise, mean / unit, root / unit[:, None]

    def _find_ratio(self, least: float) -> float:
        """Return the logarithm of the ratio of the variances of maximum restricted likelihood."""
        from scipy.optimize import minimize_scalar

        log_ratios = np.linspace(
            DISCREPANCY.least_log_ratio, DISCREPANCY.most_log_ratio, DISCREPANCY.n_ratios
        )
        grid = log_ratios - 2.0 * np.log(self.s.max())
        costs = [self._cost(ratio, least) for ratio in grid]
        best = int(np.argmin(costs))
        bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        options = {"xatol": 1e-3}
        found = minimize_scalar(
            self._cost, bounds=bracket, args=(least,), method="bounded", options=options
        )
        return float(found.x)

    def _shift(
        self, noise: float, size: float, prior_rows: RealArray
    ) -> tuple[RealArray, RealArray]:
        """Return mean and covariance of the shift due to the changes, at given variances."""
        # The changes come first in the stacked problem, so the last block of its triangle belongs
        # to the shift alone. The covariance at known changes, which is due to noise, is
        # subtracted.
        k, m = self.effects.shape
        known_changes = np.vstack([self.head / np.sqrt(noise), prior_rows / self.norms])
        triangle, mean = self._solve(noise, size, prior_rows)
        wide, narrow = (
            scipy.linalg.solve_triangular(block, np.eye(k)) / self.norms[:, None]
            for block in (triangle[m:, m:], np.linalg.qr(known_changes, mode="r"))
        )
        return mean[m:] / self.norms, wide @ wide.T - narrow @ narrow.T

    def _solve(
        self, noise: float, size: float, prior_rows: RealArray
    ) -> tuple[RealArray, RealArray]:
        """Return the triangle of the stacked problem of changes and scaled shift, and its mean."""
        k, m = self.effects.shape
        prior = prior_rows / self.norms
        top = np.hstack([self.effects / np.sqrt(noise), self.head / np.sqrt(noise)])
        below = np.hstack([self.s[:, None] * self.V / np.sqrt(noise), np.zeros((len(self.s), k))])
        small = np.hstack([np.eye(m) / np.sqrt(size), np.zeros((m, k))])
        stacked = np.vstack([top, below, small, np.hstack([np.zeros((len(prior), m)), prior])])
        right = np.zeros(len(stacked))
        right[k : k + len(self.s)] = -self.h / np.sqrt(noise)
        R = np.linalg.qr(np.column_stack([stacked, right]), mode="r")[: m + k]
        return R[:, : m + k], scipy.linalg.solve_triangular(R[:, : m + k], R[:, m + k])

    def _power(self, ratio: float) -> float:
        """Return the weighted sum of squares of the residual at a noise variance of 1."""
        return self.rest + float(np.sum(self.h**2 / (1.0 + np.exp(ratio) * self.s**2)))

    def _noise(self, ratio: float, least: float) -> float:
        return max(self._power(ratio) / self.numbers, least, float(np.finfo(float).tiny))

    def _cost(self, ratio: float, least: float) -> float:
        """Return minus the restricted log-likelihood at the logarithm of the variance ratio."""
        noise = self._noise(ratio, least)
        spread = float(np.sum(np.log1p(np.exp(ratio) * self.s**2)))
        twice = spread + self.numbers * float(np.log(noise)) + self._power(ratio) / noise
        return 0.5 * twice


def _reduce_with_errors(
    problem: Problem, x: RealArray, residual: OutputErrorSet, dofs: list[IndexArray]
) -> Local:
    """Return the reduced problem with the unknowns first, followed by the local changes."""
    n = problem.n + _KINDS * len(dofs[0])
    found = []
    for i, (part, index) in enumerate(zip(problem.parts, dofs, strict=True)):
        found.append(_reduce_cached(_LocalErrors(residual.of(i).weight, index), part, x, n))
    return join_locals(found, n)


def _reduce_cached(residual: _LocalErrors, part: FRFPart, x: RealArray, n: int) -> Local:
    """Return the reduced problem of a part, from the cache if present."""

    def compute() -> Record:
        local = reduce_residual(residual, part, x, n)
        return np.array(local.cost), local.R, local.q

    cost, R, q = part.recall(residual.name, x, compute, residual.weight, residual.dofs)
    return Local(float(cost), R, q)


def _choose_dofs(problem: Problem) -> list[IndexArray]:
    """Return the DOFs of local changes by part, evenly distributed; -1 if a part lacks one."""
    # Tests of one structure share them by label.
    most = max(DISCREPANCY.most_dofs // len(problem.parts), 1)
    chosen: dict[str, None] = {}
    labels_by_part = [part.solver.system.dofs.labels for part in problem.parts]
    for part, labels in zip(problem.parts, labels_by_part, strict=True):
        measured = np.union1d(*part.receptance_dofs)
        dofs = np.union1d(measured, part.solver.other_dofs(measured))
        chosen |= dict.fromkeys(labels[i] for i in dofs[:: -(-len(dofs) // most)])
    found = []
    for labels in labels_by_part:
        at = dict(zip(labels, range(len(labels)), strict=True))
        found.append(np.array([at.get(label, -1) for label in chosen]))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _LocalErrors(LineResidual):
    """Output error with derivatives by the unknowns, followed by those by changes at `dofs`.

    `weight`, shape (n_f, n_i, n_j), is that of `OutputError`; a DOF of -1 has no effect.
    """

    weight: RealArray
    dofs: IndexArray
    name: str = "local errors"

    def on(self, part: FRFPart, lines: slice) -> _LocalErrors:
        """Return the residual with the weights of a block of lines."""
        return replace(self, weight=self.weight[lines])

    def partition(self, part: FRFPart) -> list[slice]:
        more = _KINDS * len(self.dofs) * part.sign.size // max(part.solver.system.n, 1)
        return part.partition(len(part.rows) + len(part.columns) + more)

    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return the residual and its derivatives with respect to the unknowns and the changes."""
        block = part.block(x, lines)
        assert block.dH is not None
        errors = _error_effects(part, x, lines, self.dofs)
        J = np.asarray(np.concatenate([block.dH, errors]) * self.weight, dtype=np.complex128)
        return self.weight * (block.H - block.measured), J


def _error_effects(part: FRFPart, x: RealArray, lines: slice, dofs: IndexArray) -> ComplexArray:
    """Return dH by a unit stiffness, loss, dashpot and mass at DOFs, shape (4 m, n_f, n_i, n_j)."""
    # A change a of the dynamic stiffness at DOF p changes H_ij by -a H_ip H_pj.
    freq, s = part.frf.freq[lines], part.frf.s[lines]
    coefficients = part.solver.system.coefficients(part.state(x), 2.0 * np.pi * freq)
    loads, order = np.unique(np.append(part.rows, part.columns), return_inverse=True)
    is_present = dofs >= 0
    fields = part.solver.at(part.solver.solve(coefficients, loads, freq), dofs[is_present])
    rows, columns = order[: len(part.rows)], order[len(part.rows) :]
    H = np.zeros((len(dofs), len(freq), *part.sign.shape), dtype=np.complex128)
    H[is_present] = -fields[:, :, rows, None] * fields[:, :, None, columns]
    H *= part.gains(x) * part.sign * (s**part.frf.power)[:, None, None]
    # A loss is an imaginary stiffness of unit size; columns are scaled to equal norm later.
    by_kind = (np.ones_like(s), 1j * np.ones_like(s), s, s**2)
    return np.concatenate([H * kind[:, None, None] for kind in by_kind])
