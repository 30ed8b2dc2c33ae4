"""The update of Bao, Wang & Cheng (2010) as printed: dense, an inverse at every line.

Both compute the condensed equation error and its sensitivity matrix S (eq. 10) of every unknown.
"As printed" evaluates equations 9, 11, 17 and 18 term by term; "products kept" forms Zss^-1 Zsn
once a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from peers.measure import Case, Row, best, dense_models, once, same, steps
from updyn.updating.problem.residuals import EquationError


@dataclass(frozen=True, slots=True, eq=False)
class Textbook:
    """Dense matrices of every unit, blocks n (measured) and s (unmeasured) cut beforehand.

    Attributes
    ----------
    units : list of (loss factor, K blocks, M blocks)
        Blocks nn, ns, sn, ss.
    """

    units: list[tuple[float, tuple[Any, ...], tuple[Any, ...]]]

    @classmethod
    def of(cls, case: Case) -> Textbook:
        n = case.model.dofs.match(case.data.responses, "response").index
        s = np.setdiff1d(np.arange(case.model.n_dofs), n)

        def blocks(matrix: Any) -> tuple[Any, ...]:
            dense = matrix.toarray()
            return tuple(
                np.ascontiguousarray(dense[np.ix_(i, j)])
                for i, j in ((n, n), (n, s), (s, n), (s, s))
            )

        return cls(
            [
                (g.loss_factor, blocks(g.stiffness), blocks(g.mass))
                for g in case.model.groups.values()
            ]
        )

    def iteration(
        self, freq: np.ndarray, measured: np.ndarray, *, keep: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return I - Z_red H_X, shape (n_f, n, m), and S by mass, stiffness and loss factor."""
        K = [sum((1 + 1j * loss) * k[b] for loss, k, _ in self.units) for b in range(4)]
        M = [sum(m[b] for *_, m in self.units) for b in range(4)]
        unit = np.eye(*measured.shape[1:])
        left = np.empty_like(measured)
        S = np.empty((3 * len(self.units), *measured.shape), dtype=complex)
        for line, omega in enumerate(2 * np.pi * freq):
            Znn, Zns, Zsn, Zss = (k - omega**2 * m for k, m in zip(K, M, strict=True))
            inverse = np.linalg.inv(Zss)  # noqa: TID251 -- the peer's
            h = measured[line]
            kept = (Zns @ inverse, inverse @ Zsn) if keep else None
            left[line] = unit - (Znn - (kept[0] @ Zsn if kept else Zns @ inverse @ Zsn)) @ h
            for i, (loss, k, m) in enumerate(self.units):
                dX = -(omega**2) * _four_terms(m, Zns, inverse, Zsn, kept)
                dY = _four_terms(k, Zns, inverse, Zsn, kept)
                S[3 * i, line] = dX @ h
                S[3 * i + 1, line] = (1 + 1j * loss) * dY @ h
                S[3 * i + 2, line] = 1j * dY @ h
        return left, S


def _four_terms(
    d: tuple[Any, ...], Zns: Any, inverse: Any, Zsn: Any, kept: tuple[Any, Any] | None
) -> Any:
    """Derivative of the condensed matrix (eq. 11) for the blocks `d` of one unit's matrix."""
    nn, ns, sn, ss = d
    if kept is None:
        return nn - ns @ inverse @ Zsn - Zns @ inverse @ sn + Zns @ inverse @ ss @ inverse @ Zsn
    before, after = kept
    return nn - ns @ after - before @ sn + before @ ss @ after


def tables(options: Any) -> Iterator[tuple[str, list[Row]]]:
    lines = np.linspace(20.0, 200.0, options.dense_lines)
    for name, model in dense_models(options.dense_dofs):
        case = Case.build(model, lines)
        head = (
            f"{name}: {model.n_dofs} DOFs, {len(lines)} lines, {len(case.unknowns)} unknowns, 30"
            " sensors, 3 forces"
        )
        yield f"Condensed equation error and its Jacobian, {head}", _compare(case)


def _compare(case: Case) -> list[Row]:
    rows: list[Row] = []
    for tier in ("sparse", "dense"):
        problem = case.problem(tier)
        product, dZh = case.condensed(problem)
        taken = best(steps(EquationError(), problem))
        who = f"updyn, {tier}"
        if tier == "sparse":
            who += f", {problem.solver.backend}"
        rows.append(Row(who, taken, rows[0].against if rows else taken))
    residual = np.eye(*product.shape[1:]) - product
    peer = Textbook.of(case)
    for keep in (False, True):
        taken, (left, S) = once(
            lambda k=keep: peer.iteration(case.data.freq, case.data.values, keep=k)
        )
        differs = max(
            same(left, residual, 1e-8, "textbook, residual"), same(S, dZh, 1e-8, "textbook, S")
        )
        who = f"textbook, {'products kept' if keep else 'as printed'}"
        rows.append(Row(who, taken, rows[0].against, differs))
    return rows
