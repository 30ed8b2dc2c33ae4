"""`Transfer`: the linear part of a model, condensed exactly onto its nonlinear elements.

At each harmonic, the receptances between the deformations of elements, the force and the responses
are all that remains of the model: H = C Z^-1 B. If K, D, C and M are the same at every line, one
eigendecomposition gives H at any s = i omega: with p = s^2 - sigma (p = s - s_0 and twice as many
states, with viscous damping) and Z = A - p B_m,

    Z^-1 = X (1 - p theta)^-1 X^-1 A^-1,    A^-1 B_m = X theta X^-1.

Massless DOFs have theta = 0. At 0 Hz the stiffness is real: structural damping acts on motion only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, Term
from updyn.dynamics.pencil import decompose
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import LINE_SOLVER, PENCIL
from updyn.errors import OptionError, SolverError
from updyn.linalg.solver import check_backend
from updyn.linalg.threads import use_one_thread
from updyn.model import Model

__all__ = ["Transfer"]


@dataclass(frozen=True, slots=True, eq=False)
class Transfer:
    """Receptances to elements and responses (rows) from elements and a force (columns).

    `system` has r equations with the terms `stack`, (n_terms, r * r); `inputs` is B, (r, n_in);
    `outputs` is C, (n_out, r). `static` is H at 0 Hz, or None if the model is free there.
    """

    system: AffineSystem
    stack: RealArray
    inputs: RealArray
    outputs: RealArray
    source: str
    static: RealArray | None
    rational: _Rational | None

    @classmethod
    @use_one_thread
    def build(
        cls,
        model: Model,
        responses: IndexArray,
        references: IndexArray,
        band: tuple[float, float],
        lines: RealArray,
        *,
        tier: str | None,
        backend: str | None,
        accuracy: float,
    ) -> Transfer:
        """Return the transfer of a model; `band` in Hz is that of the first harmonic.

        `lines` in Hz are those at which a reduced model must be accurate.
        """
        W = np.stack([local.column(model.dofs) for local in model.nonlinear.values()], axis=1)
        system = AffineSystem.compile(replace(model, nonlinear={}))
        moved = np.flatnonzero(W.any(axis=1))
        loaded, read = np.union1d(moved, references), np.union1d(moved, responses)
        if tier is None:
            tier = "dense" if system.n <= LINE_SOLVER.dense_dofs else "reduced"
        if tier == "dense":
            observed, V = np.arange(system.n), np.eye(system.n)
            stack = np.stack([_whole(term, system.n) for term in system.terms])
            source = "model"
        elif tier == "reduced":
            whole = (0.0, float(lines[-1]))
            reduction = Reduction(system, read, loaded, whole, check_backend(backend), accuracy)
            reduction.build(system.start)
            found = reduction.certify(system.start, lines)
            if found.error > accuracy:
                raise SolverError(
                    f"tier 'reduced': {found.size} basis vectors reach an error of"
                    f" {found.error:.1g} of the largest receptance of a line, not {accuracy:g}; use"
                    " fewer harmonics=, or a larger accuracy="
                )
            solver = reduction.solver()
            system, observed, V, stack = solver.system, solver.observed, solver.rows, solver.stack
            source = (
                f"model, reduced to {found.size} basis vectors, error at most {found.error:.1g}"
            )
        else:
            raise OptionError(
                f"tier {tier!r}: a level needs the receptance at any frequency; expected 'dense' or"
                " 'reduced'",
                key=("tier",),
            )

        def rows(dofs: IndexArray) -> RealArray:
            return V[np.searchsorted(observed, dofs)]

        deformation = W[moved].T @ rows(moved)
        inputs = np.vstack([deformation, rows(references)]).T
        outputs = np.vstack([deformation, rows(responses)])
        stack = stack.reshape(len(stack), -1)
        weights = np.array([t.quantity == "stiffness" for t in system.terms])
        K = (weights * system.start.factor @ stack).reshape(system.n, system.n)
        out = cls(system, stack, inputs, outputs, source, _solve_static(K, inputs, outputs), None)
        return replace(out, rational=out._decompose(2.0 * np.pi * band[1]))

    def select(self, column: int, n_elements: int) -> Transfer:
        """Return the transfer with the inputs of all elements and one force."""
        kept = [*range(n_elements), n_elements + column]
        return replace(
            self,
            inputs=self.inputs[:, kept],
            static=None if self.static is None else self.static[:, kept],
            rational=None
            if self.rational is None
            else replace(self.rational, columns=self.rational.columns[:, kept]),
        )

    def keep_outputs(self, number: int) -> Transfer:
        """Return the transfer with the first outputs alone."""
        return replace(
            self,
            outputs=self.outputs[:number],
            static=None if self.static is None else self.static[:number],
            rational=None
            if self.rational is None
            else replace(self.rational, rows=self.rational.rows[:number]),
        )

    def at(self, omega: RealArray, decay: float = 0.0) -> tuple[ComplexArray, ComplexArray]:
        """Return H and dH/domega at s = i omega + decay, both (n_lines, n_out, n_in).

        `omega` in rad/s is not negative; at 0 without decay, use `static`.
        """
        if self.rational is not None:
            return self.rational.at(np.asarray(1j * omega + decay, dtype=np.complex128))
        system, state, r = self.system.with_decay(decay), self.system.start, self.system.n
        Z = (system.coefficients(state, omega).T @ self.stack).reshape(-1, r, r)
        slope = (system.slopes(state, omega).T @ self.stack).reshape(-1, r, r)
        X = np.linalg.solve(Z, np.broadcast_to(self.inputs, (len(omega), *self.inputs.shape)))
        Y = np.linalg.solve(Z, np.broadcast_to(self.outputs.T, (len(omega), *self.outputs.T.shape)))
        return self.outputs @ X, -Y.transpose(0, 2, 1) @ (slope @ X)

    def respond(self, omega: RealArray) -> ComplexArray:
        """Return H at s = i omega, (n_lines, n_out, n_in)."""
        return self.at(omega)[0]

    def _decompose(self, omega: float) -> _Rational | None:
        """Return the eigendecomposition around a frequency in rad/s, or None if it is not one."""
        system, state = self.system, self.system.start
        if any(t.table is not None and state.loss[i] for i, t in enumerate(system.terms)):
            return None
        kind, shape = np.array([t.quantity for t in system.terms]), (system.n, system.n)
        stiffness = np.where(kind == "stiffness", state.factor, 0.0)
        mass = np.where(kind == "mass", state.factor, 0.0)
        K = ((stiffness * (1.0 + 1j * state.loss)) @ self.stack).reshape(shape)
        M = (mass @ self.stack).reshape(shape)
        C = ((state.factor * state.rate) @ self.stack).reshape(shape)
        if C.any():
            return _Rational.first_order(K, C, M, self.inputs, self.outputs, omega)
        return _Rational.second_order(K, M, self.inputs, self.outputs, omega)


@dataclass(frozen=True, slots=True, eq=False)
class _Rational:
    """H(s) = rows diag(1 / (1 - (s^power - centre) theta)) columns."""

    rows: ComplexArray
    theta: ComplexArray
    columns: ComplexArray
    centre: float
    power: int

    @classmethod
    def second_order(
        cls, K: ComplexArray, M: RealArray, B: RealArray, C: RealArray, omega: float
    ) -> _Rational | None:
        """Return H for Z = K + s^2 M, around s = `omega` in 1/s."""
        return cls._of(K + omega**2 * M, -M, B, C, omega**2, 2)

    @classmethod
    def first_order(
        cls, K: ComplexArray, D: RealArray, M: RealArray, B: RealArray, C: RealArray, omega: float
    ) -> _Rational | None:
        """Return H for Z = K + s D + s^2 M, with the states q and (s - omega) q."""
        r = len(K)
        eye, none = np.eye(r), np.zeros((r, r))
        A = np.block([[K + omega * D + omega**2 * M, none], [none, eye]])
        slope = np.block([[-(D + 2.0 * omega * M), -M], [eye, none]])
        B = np.vstack([B, np.zeros_like(B)])
        return cls._of(A, slope, B, np.hstack([C, np.zeros_like(C)]), omega, 1)

    @classmethod
    def _of(
        cls,
        A: ComplexArray,
        slope: RealArray,
        B: RealArray,
        C: RealArray,
        centre: float,
        power: int,
    ) -> _Rational | None:
        """Return C (A - p slope)^-1 B, or None if the eigenvectors are not independent."""
        solved = np.linalg.solve(A, np.hstack([slope, B]))
        decomposed = decompose(solved[:, : len(A)])
        if decomposed is None:
            return None
        theta, X, lu = decomposed
        columns = lapack.zgetrs(*lu, solved[:, len(A) :])[0]
        return cls(C @ X, theta, columns, centre, power)

    def at(self, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return H and dH/domega at s = i omega + constant, both (n_lines, n_out, n_in)."""
        amplitude = 1.0 / (1.0 - (s**self.power - self.centre)[:, None] * self.theta)
        by_omega = 1j * self.power * s ** (self.power - 1)
        H = (self.rows * amplitude[:, None, :]) @ self.columns
        slope = by_omega[:, None] * self.theta * amplitude**2
        return H, (self.rows * slope[:, None, :]) @ self.columns

    def poles(self) -> tuple[ComplexArray, IndexArray]:
        """Return the poles s with a positive imaginary part, and their positions in `theta`."""
        at = np.flatnonzero(np.abs(self.theta) > np.finfo(np.float64).tiny)
        s = (self.centre + 1.0 / self.theta[at]) ** (1.0 / self.power)
        if self.power == 2:
            s = np.where(s.imag < 0.0, -s, s)
        kept = s.imag > 0.0
        return s[kept], at[kept]


def _whole(term: Term, n: int) -> RealArray:
    """Return the matrix of a term on all DOFs, shape (n, n)."""
    out, local = np.zeros((n, n)), term.local
    out[np.ix_(term.rows, term.rows)] = local if isinstance(local, np.ndarray) else local.toarray()
    return out


def _solve_static(K: RealArray, inputs: RealArray, outputs: RealArray) -> RealArray | None:
    """Return H at 0 Hz, or None if K is singular to rounding."""
    scale = np.sqrt(np.maximum(np.abs(K.diagonal()), np.finfo(np.float64).tiny))
    scaled = K / scale / scale[:, None]
    try:
        X = np.linalg.solve(scaled, inputs / scale[:, None])
    except np.linalg.LinAlgError:
        return None
    if np.linalg.cond(scaled) > 1.0 / PENCIL.least_condition**1.5:
        return None
    return np.asarray((outputs / scale) @ X)
