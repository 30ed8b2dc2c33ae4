"""FRFs of several setups, such as those of a roving hammer or sensor, as one matrix."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DataError, UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.signals.settings import SETUP_JOINING

__all__ = ["joined_frfs"]

_Unsigned = tuple[int, str]


@dataclass(frozen=True, slots=True)
class _PairPosition:
    """Setup and indices of one pair of response and reference."""

    setup: int
    row: int
    column: int


def joined_frfs(frfs: Sequence[FRF], names: Sequence[str]) -> FRF:
    """Return the FRFs of several setups as one, with pairs of DOFs by their labels.

    Parameters
    ----------
    frfs : sequence of FRF
        One per setup.
    names : sequence of str
        Names of the setups in messages: their files.

    Returns
    -------
    FRF
        Responses and references in order of appearance. If a DOF was measured in both senses (5:Z
        and 5:-Z), the first is used, and values of the other change sign. With variance if all
        setups have it, and the number of averages if it is the same. The geometry is that of all
        setups with one.

    Raises
    ------
    DataError
        If quantities or lines differ, a pair was measured twice or not at all, or a node has two
        positions or directions; the message names the setups.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> frf = chain.measure()
    >>> setups = [frf.select(responses=["2:X", "5:X"]), frf.select(responses=["12:X"])]
    >>> updyn.joined_frfs(setups, ["first.uff", "second.uff"]).responses.labels
    ['2:X', '5:X', '12:X']
    """
    if len(frfs) == 1:
        return frfs[0]
    first = frfs[0]
    for other, name in zip(frfs[1:], names[1:], strict=True):
        _check_same_lines(first, other, names[0], name)
    responses = _merge_dofs([frf.responses for frf in frfs])
    references = _merge_dofs([frf.references for frf in frfs])
    places = _index_pairs(frfs, names)
    shape = (len(first.freq), len(responses), len(references))
    values = np.empty(shape, dtype=np.complex128)
    extras = {name: np.empty(shape) for name in _find_common(frfs, names)}
    for i, response in enumerate(responses):
        for j, reference in enumerate(references):
            place = places.get((_unsigned_dof(response), _unsigned_dof(reference)))
            if place is None:
                raise DataError(_missing_pair(response, reference, frfs, names))
            frf = frfs[place.setup]
            sense = response.sign * frf.responses[place.row].sign
            sense *= reference.sign * frf.references[place.column].sign
            values[:, i, j] = sense * frf.values[:, place.row, place.column]
            for name, array in extras.items():
                array[:, i, j] = getattr(frf, name)[:, place.row, place.column]
    counts = {frf.averages for frf in frfs}
    return FRF(
        first.freq,
        values,
        responses,
        references,
        first.quantity,
        coherence=extras.get("coherence"),
        variance=extras.get("variance"),
        averages=counts.pop() if len(counts) == 1 else None,
        geometry=_joined_geometry(frfs, names),
        source="\n".join(frf.source for frf in frfs if frf.source),
        decay=first.decay,
        level=first.level,
        sweep=first.sweep,
        excitation=first.excitation,
        spectrum=first.spectrum,
    )


def _check_same_lines(first: FRF, other: FRF, name: str, its: str) -> None:
    """Raise DataError for setups with different quantities or lines."""
    if other.decay != first.decay:
        raise DataError(
            f"{its} contains the decay of a window of {other.decay:g} 1/s, {name} of"
            f" {first.decay:g} 1/s; write them to separate files"
        )
    if other.level_text != first.level_text:
        raise DataError(
            f"{its} has the {other.level_text or 'level not stated'}, {name} the"
            f" {first.level_text or 'level not stated'}; write them to separate files"
        )
    if other.quantity != first.quantity:
        raise DataError(
            f"{its} contains {other.quantity}, {name} {first.quantity}; write them to separate"
            " files"
        )
    if len(other.freq) != len(first.freq) or not np.allclose(
        other.freq, first.freq, rtol=SETUP_JOINING.line_difference, atol=0.0
    ):
        raise DataError(
            f"{its} has {_lines(other)}, {name} {_lines(first)}; records to be joined need equal"
            " lengths and time steps. Lines are not interpolated"
        )


def _find_common(frfs: Sequence[FRF], names: Sequence[str]) -> list[str]:
    """Return which of coherence and variance all setups have; warn if only some have one."""
    found = []
    for what in ("coherence", "variance"):
        without = [n for n, f in zip(names, frfs, strict=True) if getattr(f, what) is None]
        if not without:
            found.append(what)
        elif len(without) < len(frfs):
            warnings.warn(
                f"{', '.join(without)}: a single record, which has no {what}; the joined FRFs have"
                " none",
                UpdynWarning,
                stacklevel=3,
            )
    return found


def _joined_geometry(frfs: Sequence[FRF], names: Sequence[str]) -> Geometry | None:
    """Return the nodes, lines and faces of all setups with a geometry; None without any."""
    known = [(n, f.geometry) for n, f in zip(names, frfs, strict=True) if f.geometry is not None]
    if not known:
        return None
    nodes: dict[int, tuple[str, RealArray, RealArray]] = {}
    allowed = SETUP_JOINING.place_difference
    for name, geometry in known:
        axes = geometry.axes
        if axes is None:
            axes = np.broadcast_to(np.eye(3), (len(geometry.nodes), 3, 3))
        for node, xyz, node_axes in zip(geometry.nodes.tolist(), geometry.xyz, axes, strict=True):
            before, position, turned = nodes.setdefault(node, (name, xyz, node_axes))
            for what, one, other in (
                ("position", xyz, position),
                ("directions", node_axes, turned),
            ):
                if not np.allclose(one, other, rtol=allowed, atol=allowed):
                    raise DataError(
                        f"{name} gives node {node} the {what} {one.tolist()}, {before}"
                        f" {other.tolist()}; expected one for each node"
                    )
    has_axes = any(geometry.axes is not None for _, geometry in known)
    return Geometry(
        list(nodes),
        [xyz for _, xyz, _ in nodes.values()],
        np.unique(np.vstack([geometry.lines for _, geometry in known]), axis=0),
        [node_axes for _, _, node_axes in nodes.values()] if has_axes else None,
        np.unique(np.vstack([geometry.faces for _, geometry in known]), axis=0),
    )


def _lines(frf: FRF) -> str:
    return f"{len(frf.freq)} lines from {frf.freq[0]:g} to {frf.freq[-1]:g} Hz"


def _unsigned_dof(dof: Dof) -> _Unsigned:
    return dof.node, dof.direction


def _merge_dofs(sets: Sequence[DofSet]) -> DofSet:
    """Return the DOFs of several sets, each once and in the first sense."""
    found: dict[_Unsigned, Dof] = {}
    for dofs in sets:
        for dof in dofs:
            found.setdefault(_unsigned_dof(dof), dof)
    return DofSet(found.values())


def _index_pairs(
    frfs: Sequence[FRF], names: Sequence[str]
) -> dict[tuple[_Unsigned, _Unsigned], _PairPosition]:
    """Return the setup and indices of each pair, which must be unique."""
    found: dict[tuple[_Unsigned, _Unsigned], _PairPosition] = {}
    for setup, frf in enumerate(frfs):
        for row, response in enumerate(frf.responses):
            for column, reference in enumerate(frf.references):
                pair = (_unsigned_dof(response), _unsigned_dof(reference))
                before = found.setdefault(pair, _PairPosition(setup, row, column))
                if before.setup != setup:
                    raise DataError(
                        f"response {response} to reference {reference} was measured twice: in"
                        f" {names[before.setup]} and in {names[setup]}; omit it in one, or"
                        " name both files in one setup if they are hits of the same pair",
                        key=("setup", setup),
                    )
    return found


def _missing_pair(response: Dof, reference: Dof, frfs: Sequence[FRF], names: Sequence[str]) -> str:
    """Return a message on the pair that was not measured, and the setups of its DOFs."""
    with_response = [n for n, f in zip(names, frfs, strict=True) if _has_all(f.responses, response)]
    with_reference = [
        n for n, f in zip(names, frfs, strict=True) if _has_all(f.references, reference)
    ]
    return (
        f"response {response} to reference {reference} was not measured: {response} is in"
        f" {', '.join(with_response)}, {reference} in {', '.join(with_reference)}; FRFs are a"
        " complete matrix, so omit DOFs that are not in all setups"
    )


def _has_all(dofs: DofSet, dof: Dof) -> bool:
    return any(_unsigned_dof(dof) == _unsigned_dof(other) for other in dofs)
