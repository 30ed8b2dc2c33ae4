"""Measurements with gaps: cut into parts that have none, to be fitted together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import Dof, DofSet
from updyn.errors import DataError
from updyn.frf import FRF, check_lines
from updyn.geometry import Geometry

__all__ = ["complete_parts"]


def complete_parts(
    freq: ArrayLike,
    values: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str,
    coherence: ArrayLike | None = None,
    variance: ArrayLike | None = None,
    averages: int | None = None,
    geometry: Geometry | None = None,
    source: str = "",
) -> tuple[FRF, ...]:
    """Cut data in which values are missing into FRFs in which none is.

    A sensor that dropped out over some lines, or was not mounted for one of the forces, leaves
    gaps. No `FRF` has any. What was measured is cut into rectangles of lines, responses and
    references, in which pairs of response and reference with the same lines stand together. Every
    value that is there is in one of them, and nothing else. Fit them as tests of one structure
    (`updyn.update_jointly`).

    Parameters
    ----------
    freq : array_like of float, shape (n_f,)
        Lines in Hz.
    values : array_like of complex, shape (n_f, n_responses, n_references)
        As for `updyn.FRF`, but not-a-number, or masked, where a value is missing or not to be used.
    responses, references, quantity
        As for `updyn.FRF`.
    coherence, variance : array_like of float, shape of `values`, optional
        As for `updyn.FRF`. They count only where `values` has a value, and have to have one there.
    averages, geometry, source
        As for `updyn.FRF`.

    Returns
    -------
    tuple of FRF
        The largest first; one, with everything, where there is no gap. Their source says what is
        missing, in words.

    Raises
    ------
    DataError
        If nothing is left, a value is infinite, or something else than values is missing.
    DofError
        If a label cannot be read or stands twice.
    """
    lines, rows, columns = check_lines(freq), DofSet(responses), DofSet(references)
    array = np.ma.filled(np.ma.asarray(values).astype(np.complex128), np.nan)
    shape = (len(lines), len(rows), len(columns))
    if array.shape != shape:
        raise DataError(
            f"values: expected shape (lines, responses, references) = {shape}, found {array.shape}"
        )
    infinite = np.argwhere(np.isinf(array))
    if len(infinite):
        i, j, k = infinite[0]
        raise DataError(
            f"values at {lines[i]:g} Hz, response {rows[j]}, reference {columns[k]} is infinite;"
            " what is missing is not-a-number"
        )
    there = ~np.isnan(array)
    if not there.any():
        raise DataError("values: all are missing")
    told = f"{source}; {_words(there)}".removeprefix("; ") if not there.all() else source
    beside = {
        name: None if a is None else np.asarray(a)
        for name, a in (("coherence", coherence), ("variance", variance))
    }
    for name, given in beside.items():
        if given is not None and given.shape != shape:
            raise DataError(
                f"{name}: expected shape (lines, responses, references) = {shape}, found"
                f" {given.shape}"
            )

    def part(at: tuple[NDArray[np.intp], ...]) -> FRF:
        own: dict[str, Any] = {
            name: None if a is None else a[np.ix_(*at)] for name, a in beside.items()
        }
        return FRF(
            lines[at[0]],
            array[np.ix_(*at)],
            [rows[int(j)] for j in at[1]],
            [columns[int(k)] for k in at[2]],
            quantity,
            averages=averages,
            geometry=geometry,
            source=told,
            **own,
        )

    parts = [part(at) for at in _rectangles(there)]
    return tuple(
        sorted(parts, key=lambda frf: -frf.values.size)
    )  # sorted keeps the order of equals


def _rectangles(there: NDArray[np.bool_]) -> list[tuple[NDArray[np.intp], ...]]:
    """Return lines, responses and references of rectangles that cover each True once."""
    by_lines: dict[bytes, dict[int, list[int]]] = {}
    for j, k in np.ndindex(there.shape[1:]):
        if there[:, j, k].any():
            by_lines.setdefault(there[:, j, k].tobytes(), {}).setdefault(j, []).append(k)
    out: list[tuple[NDArray[np.intp], ...]] = []
    for lines, pairs in by_lines.items():
        alike: dict[tuple[int, ...], list[int]] = {}
        for j, ks in pairs.items():
            alike.setdefault(tuple(ks), []).append(j)
        at = np.flatnonzero(np.frombuffer(lines, dtype=bool))
        out += [(at, np.array(js), np.array(ks)) for ks, js in alike.items()]
    return out


def _words(there: NDArray[np.bool_]) -> str:
    """Say what is missing: ``1 of 42 channels misses 17 of 400 lines``."""
    gone = (~there).sum(axis=0).ravel()
    some, counts = int((gone > 0).sum()), np.unique(gone[gone > 0])
    few = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return (
        f"{some} of {gone.size} channels miss{'es' if some == 1 else ''} {few} of {len(there)}"
        " lines"
    )
