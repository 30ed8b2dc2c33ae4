"""scipy.optimize.least_squares with finite differences over a sparse FRF solver.

One step of both gives the log residual and its Jacobian. The peer needs one factorisation a line
for the residual and one more for every unknown, with as many right-hand sides as references; updyn
one a line, with those of the sensors too. SuperLU as tuned as updyn's own (minimum degree,
symmetric mode), entries summed on one pattern. Where the whole Jacobian would take longer than the
budget, one evaluation is timed and multiplied by their number, marked `~`, and one column is
checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import models
import numpy as np
import scipy.sparse as sp
from scipy.optimize import least_squares
from scipy.sparse.linalg import splu

from peers.measure import Case, Row, backends, best, once, same, steps
from updyn.updating.problem.residuals import LogError

#: Of the differences, absolute: unknowns are about 1, loss factors less. The default of scipy,
#: 1.5e-8 of each unknown, leaves errors of some 1e-3 at 10k DOFs.
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SparseFRF:
    """A user's own FRF of K (1 + i gamma) - omega^2 M over groups.

    Attributes
    ----------
    pattern : sparse CSC
        Of Z.
    entries : sparse, shape (nnz, 2 n_groups)
        Values on it of each group's K, then M.
    """

    case: Case
    pattern: Any
    entries: Any
    rows: np.ndarray
    columns: np.ndarray

    @classmethod
    def of(cls, case: Case) -> SparseFRF:
        groups = case.model.groups.values()
        matrices = [
            sp.csc_array(m) for m in [g.stiffness for g in groups] + [g.mass for g in groups]
        ]
        pattern = sp.csc_array(sum(abs(m) for m in matrices))
        pattern.sort_indices()
        keys = [_keys(m) for m in (pattern, *matrices)]
        data = np.concatenate([m.data for m in matrices])
        slots = np.concatenate([np.searchsorted(keys[0], k) for k in keys[1:]])
        owner = np.repeat(np.arange(len(matrices)), [m.nnz for m in matrices])
        entries = sp.csr_array(
            sp.coo_array((data, (slots, owner)), shape=(pattern.nnz, len(matrices)))
        )
        dofs = case.model.dofs
        rows = dofs.match(case.data.responses, "response")
        columns = dofs.match(case.data.references, "reference")
        return cls(case, pattern, entries, rows.index, columns.index)

    def receptance(self, x: np.ndarray) -> np.ndarray:
        """H, shape (n_f, n_i, n_j), for factors and loss factors."""
        groups = list(self.case.model.groups)
        K, M = np.ones(len(groups)), np.ones(len(groups))
        loss = np.array([g.loss_factor for g in self.case.model.groups.values()])
        for value, p in zip(x, self.case.unknowns, strict=True):
            i = groups.index(p.group)
            if p.quantity == "loss_factor":
                loss[i] = value
            else:
                (K if p.quantity == "stiffness" else M)[i] = value
        loads = np.zeros((self.pattern.shape[0], len(self.columns)), dtype=complex)
        loads[self.columns, np.arange(len(self.columns))] = 1.0
        H = []
        for omega in 2 * np.pi * self.case.data.freq:
            values = self.entries @ np.concatenate([K * (1 + 1j * loss), -(omega**2) * M])
            Z = sp.csc_array(
                (values, self.pattern.indices, self.pattern.indptr), shape=self.pattern.shape
            )
            lu = splu(
                Z,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.001,
                options={"SymmetricMode": True},
            )
            H.append(lu.solve(loads)[self.rows])
        return np.array(H)

    def residual(self, x: np.ndarray) -> np.ndarray:
        r = np.log(self.receptance(x) / self.case.data.values).ravel()
        return np.concatenate([r.real, r.imag])


def _keys(matrix: Any) -> np.ndarray:
    matrix.sort_indices()
    columns = np.repeat(np.arange(matrix.shape[1], dtype=np.int64), np.diff(matrix.indptr))
    return columns * matrix.shape[0] + matrix.indices


def compare(case: Case, budget: float) -> list[Row]:
    """Ours by every sparse backend, small models by default first; then the peer."""
    x = case.unknowns.start
    rows: list[Row] = []
    ways: list[tuple[str | None, str | None]] = [("sparse", backend) for backend in backends()]
    if case.problem().solver.tier == "dense":
        ways.insert(0, (None, None))
    for tier, backend in ways:
        problem = case.problem(tier, backend)
        step = steps(LogError(), problem)
        first, _ = once(step)
        taken = best(step)
        if not rows:
            H, dH = case.receptance(problem)
            r, J = np.log(H / case.data.values).ravel(), (dH / H).reshape(len(x), -1).T
            r, J = np.concatenate([r.real, r.imag]), np.concatenate([J.real, J.imag])
        against = rows[0].against if rows else taken
        rows.append(
            Row(
                f"updyn, {backend or 'tier by size'}",
                taken,
                against,
                note=f"first one, with its analysis: {first:.3g} s",
            )
        )
    peer = SparseFRF.of(case)
    one, theirs = once(lambda: peer.residual(x))
    differs = same(theirs, r, 1e-8, "finite differences, residual")
    if (len(x) + 1) * one <= budget:
        taken, answer = once(
            lambda: least_squares(peer.residual, x, jac="2-point", diff_step=STEP / x, max_nfev=1)
        )
        mark = ""
        error = same(answer.jac, J, 1e-3, "finite differences, Jacobian")
    else:
        again, moved = once(lambda: peer.residual(x + STEP * np.eye(len(x))[0]))
        each = min(one, again)
        taken = (len(x) + 1) * each
        mark = f"~ {len(x) + 1} evaluations of {each:.3g} s; "
        column = np.column_stack([(moved - theirs) / STEP, J[:, 1:]])
        error = same(column, J, 1e-3, "finite differences, first column")
    ours = next(row.seconds for row in rows if row.who.endswith("superlu"))
    note = f"{mark}Jacobian differs by {error:.0e}; {taken / ours:.1f} x updyn, superlu"
    return [*rows, Row("least_squares, 2-point, SuperLU", taken, rows[0].against, differs, note)]


def tables(options: Any) -> Iterator[tuple[str, list[Row]]]:
    for name in options.sparse:
        model = models.solid(models.SOLIDS[name])
        for n in options.unknowns:
            case = Case.build(model, np.linspace(200.0, 240.0, options.sparse_lines), n)
            head = (
                f"solid of {model.n_dofs} DOFs, {options.sparse_lines} lines, {n} unknowns, 30"
                " sensors, 3 forces"
            )
            yield f"Log residual and Jacobian, {head}", compare(case, options.budget)
