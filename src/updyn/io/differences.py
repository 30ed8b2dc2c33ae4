"""Groups of a model by difference, for programs that write only the sums K and M.

A deck is run unchanged, then once for each group with doubled stiffness and density. The check of
the sum detects elements whose stiffness is not proportional to the doubled property, and parts that
belong to no group.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError
from updyn.io.settings import MATRIX_FILE
from updyn.model import Matrix

__all__ = ["Matrices", "groups_by_difference"]

#: K and M of a deck, each real and symmetric, shape (N, N), or None.
Matrices: TypeAlias = tuple[Matrix | None, Matrix | None]


def groups_by_difference(
    names: Iterable[str],
    total: Matrices,
    doubled: Callable[[str], Matrices],
    dofs: DofSet,
    path: str | Path,
) -> dict[str, Matrices]:
    """Split K and M into groups by difference, with runs of the function `doubled`."""
    groups = {
        name: tuple(
            _difference(one, two, name, what, path)
            for one, two, what in zip(total, doubled(name), ("K", "M"), strict=True)
        )
        for name in names
    }
    for at, what in enumerate(("K", "M")):
        parts = [g[at] for g in groups.values() if g[at] is not None]
        _check_sum(total[at], parts, what, dofs, path)
    return {name: (K, M) for name, (K, M) in groups.items()}


def _difference(
    one: Matrix | None, two: Matrix | None, name: str, what: str, path: str | Path
) -> Matrix | None:
    if one is None or two is None:
        if one is two:
            return None
        raise FormatError(f"group {name!r}: {what} is present in only one of two runs", path)
    if one.shape != two.shape:
        raise FormatError(
            f"group {name!r}: {what} has {two.shape[0]} DOFs in the doubled run and {one.shape[0]}"
            " in the unchanged run",
            path,
        )
    out = sp.csr_array(two - one)
    # Rounding differences of equal numbers do not belong to the group.
    scale = _scale(one)
    entry = out.tocoo()
    is_rounding = np.abs(entry.data) <= MATRIX_FILE.entry_rounding * scale[entry.row]
    values = np.where(is_rounding, 0.0, entry.data)
    out = sp.csr_array((values, (entry.row, entry.col)), shape=out.shape)
    out.eliminate_zeros()
    return out if out.nnz else None


def _check_sum(
    total: Matrix | None,
    parts: list[Matrix],
    what: str,
    dofs: DofSet,
    path: str | Path,
) -> None:
    if total is None:
        return
    remainder = sp.csr_array(total)
    for part in parts:
        remainder = remainder - part
    entry, scale = sp.coo_array(remainder), _scale(total)
    allowed = MATRIX_FILE.sum_tolerance * np.maximum(scale[entry.row], scale[entry.col])
    beyond = np.abs(entry.data) - allowed
    if beyond.size and beyond.max() > 0.0:
        worst = int(np.argmax(beyond))
        raise FormatError(
            f"the groups do not add up to {what}: at {dofs[int(entry.row[worst])]},"
            f" {dofs[int(entry.col[worst])]} the difference is {entry.data[worst]:.3g} (allowed"
            f" {allowed[worst]:.1g}); a part belongs to no group, or is not proportional to its"
            " modulus or density",
            path,
        )


def _scale(matrix: Matrix) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the largest entry of each row."""
    largest = abs(sp.csr_array(matrix)).max(axis=1)
    return np.asarray(largest.toarray(), dtype=np.float64).ravel()
