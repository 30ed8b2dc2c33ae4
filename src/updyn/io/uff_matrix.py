"""From single functions of a universal file to a complete matrix of FRFs."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import FormatError, InputError, UpdynWarning
from updyn.geometry import Geometry
from updyn.io.guard import chosen, placed
from updyn.io.uff58 import Function

__all__ = ["Directions", "Parts", "assemble"]

_Pair = tuple[tuple[int, str], tuple[int, str]]
_PARALLEL = 1e-6


class Directions:
    """Turns node and direction code of a file into a DOF, of the global system or of that of its node.

    Parameters
    ----------
    path : path
        The file, for messages.
    scalar : Dof or None
        Direction and sign that code 0 stands for.
    geometry : Geometry or None
        The nodes of the file, with their displacement directions.
    local : bool
        Whether directions stay those of the node.
    """

    def __init__(
        self, path: str | Path, scalar: Dof | None, geometry: Geometry | None, local: bool = False
    ) -> None:
        self.path, self.scalar, self.geometry, self.local = path, scalar, geometry, local
        self._row = {} if geometry is None else {int(n): i for i, n in enumerate(geometry.nodes)}

    def dof(self, what: str, node: int, code: int, line: int) -> Dof:
        """Return the DOF.

        Parameters
        ----------
        what : str
            "response" or "reference".
        node, code : int
            As record 6 has them.
        line : int
            Line of the dataset; record 6 stands six further on.

        Raises
        ------
        FormatError
            If the code is none, is 0 and nothing says what it stands for, the node is not in the
            geometry, or the direction is oblique to the global axes and is not to stay as it is.
        """
        at = line + 6
        if not -6 <= code <= 6:
            raise FormatError(f"record 6: {what} direction {code}; expected -6 to 6", self.path, at)
        if code == 0 and self.scalar is None:
            raise FormatError(
                f"record 6: {what} direction 0 (scalar) at node {node} says no direction: give"
                " scalar_direction='Z' or what it is",
                self.path,
                at,
            )
        dof = Dof(node, DIRECTIONS[abs(code) - 1], 1 if code > 0 else -1)
        if code == 0 and self.scalar is not None:
            dof = Dof(node, self.scalar.direction, self.scalar.sign)
        return dof if self.geometry is None else self._in_global(dof, self.geometry, what, at)

    def _in_global(self, dof: Dof, geometry: Geometry, what: str, at: int) -> Dof:
        if dof.node not in self._row:
            try:
                geometry.position([dof.node])
            except InputError as error:
                raise FormatError(f"record 6: {what} {dof}: {error}", self.path, at) from error
        if geometry.axes is None or self.local:
            return dof
        axis = DIRECTIONS.index(dof.direction)
        vector = geometry.axes[self._row[dof.node], axis % 3] * dof.sign
        k = int(np.argmax(np.abs(vector)))
        along = np.zeros(3)
        along[k] = np.sign(vector[k])
        if np.abs(vector - along).max() > _PARALLEL:
            shown = ", ".join(f"{v:.6g}" for v in vector)
            raise FormatError(
                f"record 6: {what} {dof} is oblique: its displacement system turns it to ({shown})"
                " in the global one, along none of the axes; keep the directions of nodes with"
                " local_axes=True and match them with updyn.match ([match] of a job), or transform"
                " the measurement to global directions first",
                self.path,
                at,
            )
        return Dof(dof.node, DIRECTIONS[k + (3 if axis >= 3 else 0)], int(along[k]))


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """A complete matrix, in the unit of the file.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        FRFs.
    coherence : ndarray of float, shape of `values`, or None
        Ordinary coherence.
    responses, references : DofSet
        In the order of the file, or as asked for.
    """

    freq: NDArray[np.float64]
    values: NDArray[np.complex128]
    coherence: NDArray[np.float64] | None
    responses: DofSet
    references: DofSet


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    function: Function
    response: Dof
    reference: Dof

    @property
    def key(self) -> _Pair:
        return (self.response.node, self.response.direction), (
            self.reference.node,
            self.reference.direction,
        )

    @property
    def pair(self) -> str:
        return f"response {self.response}, reference {self.reference}"


def assemble(
    measured: Sequence[Function],
    coherences: Sequence[Function],
    directions: Directions,
    *,
    average: bool,
    responses: Iterable[str | Dof] | None,
    references: Iterable[str | Dof] | None,
) -> Parts:
    """Put functions into a matrix.

    Parameters
    ----------
    measured, coherences : sequence of Function
        FRFs, and coherences.
    directions : Directions
        Turns direction codes into DOFs.
    average : bool
        Whether functions at one pair are averaged; else they are an error.
    responses, references : iterable of str or Dof, or None
        DOFs to keep; None: all.

    Returns
    -------
    Parts
        The matrix.

    Raises
    ------
    FormatError
        If a pair is missing or there twice, a DOF is not in the file, or abscissae differ.

    Warns
    -----
    UpdynWarning
        If coherence is left out because it does not belong to every FRF.
    """
    path = directions.path
    rows, columns = _Chosen("response", path), _Chosen("reference", path)
    found = [_place(f, directions) for f in measured]
    for item in found:
        rows.meet(item.response)
        columns.meet(item.reference)
    rows.keep(responses)
    columns.keep(references)
    frfs = _by_pair(found, rows, columns)
    cohs = _by_pair([_place(f, directions) for f in coherences], rows, columns)
    _complete(frfs, rows, columns, path)
    if not average:
        _single([*frfs.values(), *cohs.values()], path)
    freq = next(iter(frfs.values()))[0].function.x
    for items in (*frfs.values(), *cohs.values()):
        for item in items:
            _same_lines(item, freq, path)
    shape = (len(freq), len(rows.kept), len(columns.kept))
    values = np.empty(shape, dtype=np.complex128)
    coherence = np.empty(shape) if _usable(frfs, cohs, path) else None
    for i, r in enumerate(rows.kept):
        for j, c in enumerate(columns.kept):
            key = (_name(r), _name(c))
            signs = [x.response.sign * x.reference.sign * r.sign * c.sign for x in frfs[key]]
            gamma = [_gamma(x, path) for x in cohs.get(key, ())]
            values[:, i, j] = _mean(
                [x.function.y * sign for x, sign in zip(frfs[key], signs, strict=True)], gamma
            )
            if coherence is not None:
                coherence[:, i, j] = np.mean(gamma, axis=0)
    return Parts(freq, values, coherence, rows.kept, columns.kept)


def _place(function: Function, directions: Directions) -> _Placed:
    return _Placed(
        function,
        directions.dof("response", *function.response, function.line),
        directions.dof("reference", *function.reference, function.line),
    )


def _name(dof: Dof) -> tuple[int, str]:
    return dof.node, dof.direction


class _Chosen:
    """The DOFs of one side, in the order met, each with the sense met first; then those to keep."""

    def __init__(self, what: str, path: str | Path) -> None:
        self.what, self.path = what, path
        self.met: dict[tuple[int, str], Dof] = {}
        self.kept = DofSet([])

    def meet(self, dof: Dof) -> None:
        self.met.setdefault(_name(dof), dof)

    def keep(self, wanted: Iterable[str | Dof] | None) -> None:
        held = DofSet(self.met.values())
        if wanted is None:
            self.kept = held
            return
        self.kept = chosen(wanted, f"{self.what}s", self.path)
        with placed(self.path, f"{self.what}s"):
            held.match(self.kept, self.what)

    def __contains__(self, dof: Dof) -> bool:
        return dof in self.kept


def _by_pair(
    items: Sequence[_Placed], rows: _Chosen, columns: _Chosen
) -> dict[_Pair, list[_Placed]]:
    out: dict[_Pair, list[_Placed]] = {}
    keep_rows, keep_columns = {_name(d) for d in rows.kept}, {_name(d) for d in columns.kept}
    for item in items:
        if item.key[0] in keep_rows and item.key[1] in keep_columns:
            out.setdefault(item.key, []).append(item)
    return out


def _complete(
    frfs: Mapping[_Pair, list[_Placed]], rows: _Chosen, columns: _Chosen, path: str | Path
) -> None:
    missing = [
        f"{r} / {c}" for c in columns.kept for r in rows.kept if (_name(r), _name(c)) not in frfs
    ]
    if missing:
        shown = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
        raise FormatError(
            f"{len(missing)} of {len(rows.kept) * len(columns.kept)} pairs of response / reference"
            f" are missing: {shown}. Read a complete part with responses=[...] and"
            " references=[...]",
            path,
        )


def _single(groups: Sequence[list[_Placed]], path: str | Path) -> None:
    for first, *more in groups:
        for second in more:
            raise FormatError(
                f"{second.function.name} at {second.pair} stands twice: also on line"
                f" {first.function.line}; choose duplicates='average' to take the mean",
                path,
                second.function.line,
            )


def _same_lines(item: _Placed, freq: NDArray[np.float64], path: str | Path) -> None:
    x = item.function.x
    if len(x) == len(freq) and np.allclose(x, freq, rtol=1e-9, atol=0):
        return
    raise FormatError(
        f"{item.function.name} at {item.pair} has {len(x)} lines from {x[0]:g} to {x[-1]:g} Hz, the"
        f" first FRF has {len(freq)} from {freq[0]:g} to {freq[-1]:g} Hz (or differs in between):"
        " lines are not aligned",
        path,
        item.function.line,
    )


def _usable(
    frfs: Mapping[_Pair, list[_Placed]], cohs: Mapping[_Pair, list[_Placed]], path: str | Path
) -> bool:
    """Return whether every FRF has its coherence; warn where only some have."""
    with_it = [key for key, items in frfs.items() if len(cohs.get(key, ())) == len(items)]
    if cohs and len(with_it) < len(frfs):
        warnings.warn(
            f"{path}: coherence belongs to {len(with_it)} of {len(frfs)} pairs of DOFs; it is left"
            " out, as it has to be there for all or none",
            UpdynWarning,
            stacklevel=4,
        )
    return bool(cohs) and len(with_it) == len(frfs)


def _gamma(item: _Placed, path: str | Path) -> NDArray[np.float64]:
    y = item.function.y
    if np.iscomplexobj(y) and (y.imag != 0).any():
        raise FormatError(
            f"coherence at {item.pair} has an imaginary part", path, item.function.line
        )
    if (y.real < 0).any() or (y.real > 1).any():
        worst = y.real[np.argmax(np.abs(y.real - 0.5))]
        raise FormatError(
            f"coherence at {item.pair} is {worst:g}; expected 0 to 1", path, item.function.line
        )
    return np.asarray(y.real, dtype=np.float64)


def _mean(
    values: Sequence[NDArray[Any]], gamma: Sequence[NDArray[np.float64]]
) -> NDArray[np.complex128]:
    """Return the mean, weighted line by line with the coherence where each has it and not all of it is 0."""
    if len(values) == 1:
        return np.asarray(values[0], dtype=np.complex128)
    weights = (
        np.array(gamma) if len(gamma) == len(values) else np.ones((len(values), len(values[0])))
    )
    weights[:, weights.sum(axis=0) == 0] = 1.0
    return np.asarray((weights * np.array(values)).sum(axis=0) / weights.sum(axis=0))
