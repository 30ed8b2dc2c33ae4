"""Identifiability: rank, null space in group names, determined combinations, covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, RealArray
from updyn.text_table import printable, text_table
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.settings import NULL_SPACE
from updyn.updating.judge.settings import LIST_LENGTHS

__all__ = [
    "Analysis",
    "Identifiability",
    "analyse_identifiability",
]


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """Identifiability (`report`) with the matrices from which it was computed.

    `null_space`, shape (n, k), is an orthonormal basis of the undetermined directions of the
    optimiser's coordinates; `covariance`, shape (n, n), excludes directions that the Jacobian
    leaves undetermined. `involved` marks the unknowns in such a direction, or with the largest
    weight in a direction that is undetermined because of noise.
    """

    report: Identifiability
    null_space: RealArray
    covariance: RealArray
    involved: BoolArray


def analyse_identifiability(
    R: RealArray,
    names: list[str],
    *,
    inflation: float = 1.0,
    equal_rows: RealArray | None = None,
) -> Analysis:
    """Analyse a reduced Jacobian (k, n) by the optimiser's coordinates, for unit variance.

    `inflation` scales standard deviations; `equal_rows` is a Jacobian of the same null space
    (`NormalisedDerivatives`).
    """
    # A direction is undetermined by rank (a singular value with unit columns below the rank
    # tolerance) or because of noise (a standard deviation above 1). Collinearity index: Brun,
    # Reichert & Kuensch, Water Resour. Res. 37 (2001) 1015.
    found = resolve(R, inflation, equal_rows)
    n, s = R.shape[1], found.singular_values
    smallest = float(s[-1] / s[0]) if s[0] > 0 else 0.0
    report = Identifiability(
        rank=n - found.null_space.shape[1],
        n_parameters=n,
        condition=1.0 / smallest if found.full_rank else np.inf,
        singular_values=tuple(s.tolist()),
        null_directions=[_weights(d, names) for d in _sparse_basis(found.null_space)],
        determined_directions=_find_determined_combinations(
            found.null_space, found.involved, names
        ),
        collinearity=float(1.0 / s[-1]) if found.full_rank else np.inf,
    )
    return Analysis(report, found.null_space, found.covariance, found.involved)


def _number_combinations(
    kind: str, directions: Sequence[Mapping[str, float]]
) -> dict[str, Mapping[str, float]]:
    """Return the first combinations by their column heading."""
    first = directions[: LIST_LENGTHS.table_combinations]
    return {f"{kind} {i}": weights for i, weights in enumerate(first, 1)}


def _sparse_basis(basis: RealArray) -> list[RealArray]:
    """Return a sparse basis of the same space, each direction led by another unknown."""
    k = basis.shape[1]
    if k == 0:
        return []
    pivots = scipy.linalg.qr(basis.T, mode="r", pivoting=True)[1][:k]
    reduced = np.linalg.solve(basis[pivots].T, basis.T)
    return [d / d[np.argmax(np.abs(d))] for d in reduced]


def _weights(direction: RealArray, names: list[str]) -> dict[str, float]:
    return {
        name: float(w)
        for name, w in zip(names, direction, strict=True)
        if abs(w) > NULL_SPACE.visible_weight
    }


def _find_determined_combinations(
    null_space: RealArray, involved: BoolArray, names: list[str]
) -> list[dict[str, float]]:
    """Return the combinations of the involved unknowns that are constant along the null space."""
    k = null_space.shape[1]
    if k == 0:
        return []
    pivots = scipy.linalg.qr(null_space.T, mode="r", pivoting=True)[1][:k]
    share = np.linalg.solve(null_space[pivots].T, null_space.T).T
    out = []
    for i in np.flatnonzero(involved):
        if i in pivots:
            continue
        combination = {names[i]: 1.0}
        for pivot, weight in zip(pivots, share[i], strict=True):
            if abs(weight) > NULL_SPACE.visible_weight:
                combination[names[pivot]] = float(-weight)
        out.append(combination)
    return out


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Combinations of the unknowns that the data determine.

    Attributes
    ----------
    rank : int
        Number of independent determined combinations.
    n_parameters : int
        Number of unknowns.
    condition : float
        Condition number of the Jacobian with columns scaled to unit norm; inf if rank-deficient.
    singular_values : tuple of float
        Its singular values, in descending order.
    null_directions : list of dict of str to float
        Undetermined combinations, as weights by unknown: a joint change by these weights does not
        change the measured quantities. The largest weight is 1; weights below 1e-3 are omitted.
    determined_directions : list of dict of str to float
        Determined combinations of the unknowns that take part in an undetermined combination.
    collinearity : float
        Brun's index 1 / smallest singular value (above 10-15: not separable in practice).
    advice : str
        Advice in one or two sentences.
    """

    rank: int
    n_parameters: int
    condition: float
    singular_values: tuple[float, ...]
    null_directions: list[dict[str, float]]
    determined_directions: list[dict[str, float]]
    collinearity: float
    advice: str = ""

    def __repr__(self) -> str:
        head = (
            f"Identifiability(rank {self.rank} of {self.n_parameters}, condition"
            f" {self.condition:.3g}, collinearity {self.collinearity:.3g})"
        )
        columns = {
            **_number_combinations("undetermined", self.null_directions),
            **_number_combinations("determined", self.determined_directions),
        }
        names = list(dict.fromkeys(name for weights in columns.values() for name in weights))
        rows = []
        for name in names:
            found = [weights.get(name) for weights in columns.values()]
            rows.append([printable(name), *("" if w is None else f"{w:+.3g}" for w in found)])
        parts = [head]
        if rows:
            parts.append(text_table(("weight in", *columns), rows))
        hidden = len(self.null_directions) + len(self.determined_directions) - len(columns)
        if hidden:
            parts.append(f"... and {hidden} more combinations")
        if self.advice:
            parts.append(printable(self.advice))
        return "\n".join(parts)

    def describe_combinations(self) -> list[str]:
        """Return a line of text for each combination, the largest weight first."""
        kinds = (
            ("undetermined combination", self.null_directions),
            ("of these, determined", self.determined_directions),
        )
        lines = []
        for kind, directions in kinds:
            for number, direction in enumerate(directions, 1):
                largest_first = sorted(direction.items(), key=lambda item: -abs(item[1]))
                weights = ", ".join(f"{weight:+.3g} {name}" for name, weight in largest_first)
                lines.append(f"  {kind} {number}: {weights}")
        return lines

    @property
    def complete(self) -> bool:
        """Whether all unknowns are determined."""
        return self.rank == self.n_parameters
