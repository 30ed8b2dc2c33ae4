"""FRFs of several setups, such as those of a hammer or a sensor that roves, as one matrix."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import Dof, DofSet
from updyn.errors import DataError, UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry

__all__ = ["joined_frfs"]

#: Lines of two setups are the same where they differ by this share at most.
_SAME_LINE = 1e-9
#: Positions (in m) and directions of a node are the same where they differ by this at most, or by
#: this share.
_SAME_PLACE = 1e-6
_Unsigned = tuple[int, str]
_Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Place:
    """Where one pair of response and reference was measured."""

    setup: int
    row: int
    column: int


def joined_frfs(frfs: Sequence[FRF], names: Sequence[str]) -> FRF:
    """Return the FRFs of several setups as one, each pair of DOFs where its labels say.

    Parameters
    ----------
    frfs : sequence of FRF
        Each of its own setup.
    names : sequence of str
        What the setups are called in messages: their files.

    Returns
    -------
    FRF
        Responses and references in the order in which they are met. Where a DOF was measured with
        both senses (5:Z and 5:-Z), the first is taken, and values of the other change sign. With
        variance where all setups have it, and the number of averages where it is one. Geometry is
        that of all setups that have one.

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
        _check_alike(first, other, names[0], name)
    responses = _merged([frf.responses for frf in frfs])
    references = _merged([frf.references for frf in frfs])
    places = _places(frfs, names)
    shape = (len(first.freq), len(responses), len(references))
    values = np.empty(shape, dtype=np.complex128)
    extras = {name: np.empty(shape) for name in _common(frfs, names)}
    for i, response in enumerate(responses):
        for j, reference in enumerate(references):
            place = places.get((_unsigned(response), _unsigned(reference)))
            if place is None:
                raise DataError(_missing(response, reference, frfs, names))
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
    )


def _check_alike(first: FRF, other: FRF, name: str, its: str) -> None:
    """Refuse setups that are not of one quantity and on the same lines."""
    if other.decay != first.decay:
        raise DataError(
            f"{its} has the decay of a window of {other.decay:g} 1/s left, {name} of"
            f" {first.decay:g} 1/s; write them to files of their own"
        )
    if other.quantity != first.quantity:
        raise DataError(
            f"{its} gives {other.quantity}, {name} {first.quantity}; write them to files of their"
            " own"
        )
    if len(other.freq) != len(first.freq) or not np.allclose(
        other.freq, first.freq, rtol=_SAME_LINE, atol=0.0
    ):
        raise DataError(
            f"{its} has {_lines(other)}, {name} {_lines(first)}; records to be joined need one"
            " length and one step in time. Lines are not interpolated"
        )


def _common(frfs: Sequence[FRF], names: Sequence[str]) -> list[str]:
    """Return which of coherence and variance all setups have; warn where only some have."""
    found = []
    for what in ("coherence", "variance"):
        without = [n for n, f in zip(names, frfs, strict=True) if getattr(f, what) is None]
        if not without:
            found.append(what)
        elif len(without) < len(frfs):
            warnings.warn(
                f"{', '.join(without)}: a single record, which has no {what}; the joined FRFs are"
                " without it",
                UpdynWarning,
                stacklevel=3,
            )
    return found


def _joined_geometry(frfs: Sequence[FRF], names: Sequence[str]) -> Geometry | None:
    """Return the nodes, lines and faces of all setups that have some; None where none has."""
    known = [(n, f.geometry) for n, f in zip(names, frfs, strict=True) if f.geometry is not None]
    if not known:
        return None
    nodes: dict[int, tuple[str, _Real, _Real]] = {}
    for name, geometry in known:
        axes = geometry.axes
        if axes is None:
            axes = np.broadcast_to(np.eye(3), (len(geometry.nodes), 3, 3))
        for node, xyz, own in zip(geometry.nodes.tolist(), geometry.xyz, axes, strict=True):
            before, there, turned = nodes.setdefault(node, (name, xyz, own))
            for what, one, other in (("position", xyz, there), ("directions", own, turned)):
                if not np.allclose(one, other, rtol=_SAME_PLACE, atol=_SAME_PLACE):
                    raise DataError(
                        f"{name} gives node {node} the {what} {one.tolist()}, {before}"
                        f" {other.tolist()}; a node stands in one place"
                    )
    has_axes = any(geometry.axes is not None for _, geometry in known)
    return Geometry(
        list(nodes),
        [xyz for _, xyz, _ in nodes.values()],
        np.unique(np.vstack([geometry.lines for _, geometry in known]), axis=0),
        [own for _, _, own in nodes.values()] if has_axes else None,
        np.unique(np.vstack([geometry.faces for _, geometry in known]), axis=0),
    )


def _lines(frf: FRF) -> str:
    return f"{len(frf.freq)} lines from {frf.freq[0]:g} to {frf.freq[-1]:g} Hz"


def _unsigned(dof: Dof) -> _Unsigned:
    return dof.node, dof.direction


def _merged(sets: Sequence[DofSet]) -> DofSet:
    """Return the DOFs of several sets, each once and with the sense met first."""
    found: dict[_Unsigned, Dof] = {}
    for dofs in sets:
        for dof in dofs:
            found.setdefault(_unsigned(dof), dof)
    return DofSet(found.values())


def _places(frfs: Sequence[FRF], names: Sequence[str]) -> dict[tuple[_Unsigned, _Unsigned], _Place]:
    """Return where each pair was measured, once."""
    found: dict[tuple[_Unsigned, _Unsigned], _Place] = {}
    for setup, frf in enumerate(frfs):
        for row, response in enumerate(frf.responses):
            for column, reference in enumerate(frf.references):
                pair = (_unsigned(response), _unsigned(reference))
                before = found.setdefault(pair, _Place(setup, row, column))
                if before.setup != setup:
                    raise DataError(
                        f"response {response} to reference {reference} was measured twice: in"
                        f" {names[before.setup]} and in {names[setup]}; leave it out of one, or"
                        " name both files in one setup if they are hits of the same",
                        key=("setup", setup),
                    )
    return found


def _missing(response: Dof, reference: Dof, frfs: Sequence[FRF], names: Sequence[str]) -> str:
    """Say which pair was not measured, and where its DOFs were."""
    with_response = [n for n, f in zip(names, frfs, strict=True) if _has(f.responses, response)]
    with_reference = [n for n, f in zip(names, frfs, strict=True) if _has(f.references, reference)]
    return (
        f"response {response} to reference {reference} was not measured: {response} stands in"
        f" {', '.join(with_response)}, {reference} in {', '.join(with_reference)}; FRFs are a"
        " complete matrix, so leave out what is not in all of them"
    )


def _has(dofs: DofSet, dof: Dof) -> bool:
    return any(_unsigned(dof) == _unsigned(other) for other in dofs)
