"""Bulk data in OUTPUT2 files: grids, coordinate systems and elements, as cards of a deck.

Records of GEOM1 and GEOM2 start with an identifying key of three integers. For some kinds, the
number of words of an entry differs between MSC, NX and releases; the reader uses the first number
for which all entries are valid. Layouts: MSC Nastran and NX Nastran DMAP Programmer's Guides, data
blocks GEOM1 and GEOM2.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import ELEMENTS, NastranDeck, build_points_deck
from updyn.io.nastran.fields import NastranLine
from updyn.io.nastran.op2_file import OP2File

__all__ = ["build_deck"]

_POINTS = ("GEOM1", "GEOM1S", "GEOM1N")
_ELEMENTS = ("GEOM2", "GEOM2S", "GEOM2N")
_Key = tuple[int, ...]
#: Start of the key after the last entry.
_END = (65535, 65535)
_GRID: _Key = (4501, 45, 1)
_SPOINT: _Key = (5551, 49, 105)
_CORD1: Mapping[_Key, str] = {
    (1801, 18, 5): "CORD1R",
    (1701, 17, 6): "CORD1C",
    (1901, 19, 7): "CORD1S",
}
_CORD2: Mapping[_Key, str] = {
    (2101, 21, 8): "CORD2R",
    (2001, 20, 9): "CORD2C",
    (2201, 22, 10): "CORD2S",
}
#: Coordinate systems without listed positions, which Nastran computes: CORD3G, and the like.
_NOT_READ: Mapping[_Key, str] = {(501, 5, 43): "CORD3G", (14301, 143, 651): "CORD3G"}


@dataclass(frozen=True, slots=True)
class _Entry:
    """Layout of an element in the table GEOM2; several `widths` if programs differ."""

    name: str
    widths: tuple[int, ...]
    grids: tuple[int, ...]


def _words(n: int) -> tuple[int, ...]:
    return tuple(range(2, 2 + n))


#: MSC and NX use the same key for all elements in this table.
_ENTRIES: Mapping[_Key, _Entry] = {
    (2408, 24, 180): _Entry("CBAR", (16,), (2, 3)),
    (5408, 54, 261): _Entry("CBEAM", (18,), (2, 3)),
    (3001, 30, 48): _Entry("CROD", (4,), (2, 3)),
    (3701, 37, 49): _Entry("CTUBE", (4,), (2, 3)),
    (1601, 16, 47): _Entry("CONROD", (8,), (1, 2)),
    (2608, 26, 60): _Entry("CBUSH", (14,), (2, 3)),
    (601, 6, 73): _Entry("CELAS1", (6,), (2, 3)),
    (701, 7, 74): _Entry("CELAS2", (8,), (2, 3)),
    (201, 2, 69): _Entry("CDAMP1", (6,), (2, 3)),
    (301, 3, 70): _Entry("CDAMP2", (6,), (2, 3)),
    (1001, 10, 65): _Entry("CMASS1", (6,), (2, 3)),
    (1101, 11, 66): _Entry("CMASS2", (6,), (2, 3)),
    (1501, 15, 64): _Entry("CONM2", (13,), (1,)),
    (2958, 51, 177): _Entry("CQUAD4", (14, 15), _words(4)),
    (8009, 80, 367): _Entry("CQUADR", (14, 15), _words(4)),
    (4701, 47, 326): _Entry("CQUAD8", (17, 16, 18), _words(8)),
    (5959, 59, 282): _Entry("CTRIA3", (13, 14), _words(3)),
    (9200, 92, 385): _Entry("CTRIAR", (13, 14), _words(3)),
    (4801, 48, 327): _Entry("CTRIA6", (14, 13, 15), _words(6)),
    (3101, 31, 61): _Entry("CSHEAR", (6,), _words(4)),
    (5508, 55, 217): _Entry("CTETRA", (12,), _words(10)),
    (4108, 41, 280): _Entry("CPENTA", (17,), _words(15)),
    (7308, 73, 253): _Entry("CHEXA", (22,), _words(20)),
}
#: Entries of GEOM2 without elements to draw.
_PASSED: frozenset[_Key] = frozenset({(5201, 52, 11)})


def build_deck(file: OP2File) -> NastranDeck:
    """Return the grids, coordinate systems and elements, without properties and materials."""
    # Identical entries, such as the boundaries of superelements, are kept once.
    if not file.tables_named(*_POINTS):
        held = ", ".join(dict.fromkeys(block.name for block in file.blocks)) or "nothing"
        raise AbsentError(
            "holds no geometry (table GEOM1; Nastran writes it by PARAM,POST,-1 and"
            f" PARAM,OGEOM,YES); it holds {held}. It can be read from the deck (.bdf)",
            file.path,
        )
    line = NastranLine("", file.path, None)
    found: dict[tuple[str, tuple[str, ...]], None] = {}
    grids: set[int] = set()
    for key, raw in _records(file, _POINTS):
        if key == _GRID:
            entries = _grids(file, raw)
            grids.update(int(fields[0]) for fields in entries)
            found |= dict.fromkeys(("GRID", fields) for fields in entries)
        elif key in _CORD1:
            found |= dict.fromkeys((_CORD1[key], fields) for fields in _cord1(file, raw))
        elif key in _CORD2:
            found |= dict.fromkeys((_CORD2[key], fields) for fields in _cord2(file, raw))
        elif key in _NOT_READ:
            raise FormatError(
                f"{_NOT_READ[key]}: this kind of coordinate system is not supported", file.path
            )
    records = list(_records(file, _ELEMENTS))
    for key, raw in records:
        if key == _SPOINT:
            points = file.words(raw).tolist()
            grids.update(points)
            found |= dict.fromkeys(("SPOINT", (str(point),)) for point in points)
    others: dict[str, None] = {}
    for key, raw in records:
        if key in _ENTRIES:
            entry = _ENTRIES[key]
            found |= dict.fromkeys((entry.name, f) for f in _elements(file, entry, raw, grids))
        elif key not in _PASSED and key != _SPOINT:
            others[f"entries of the key {key}"] = None
    if others:
        warnings.warn(
            f"{file.path}: unknown elements are not drawn: {', '.join(others)}",
            UpdynWarning,
            stacklevel=4,
        )
    return build_points_deck(
        file.path, [NastranCard(name, fields, (line,)) for name, fields in found]
    )


def _records(file: OP2File, names: tuple[str, ...]) -> Iterator[tuple[_Key, bytes]]:
    """Yield keys and entries of the records of some tables."""
    start = 3 * file.size
    for block in file.tables_named(*names):
        for record in block.records:
            raw = file.data(record)
            if len(raw) < start:
                raise FormatError(f"{block.name}: a record of {len(raw)} bytes: damaged", file.path)
            key = tuple(file.words(raw[:start]).tolist())
            if key[:2] != _END:
                yield key, raw[start:]


def _decode_entries(
    file: OP2File,
    name: str,
    raw: bytes,
    layouts: tuple[np.dtype[Any], ...],
    is_valid: Callable[[NumberArray], bool],
) -> NumberArray:
    """Return the entries of a record in the first layout for which all are valid."""
    for layout in layouts:
        if len(raw) % layout.itemsize == 0:
            entries = np.frombuffer(raw, layout)
            if is_valid(entries):
                return entries
    widths = " or ".join(str(layout.itemsize // file.size) for layout in layouts)
    raise FormatError(
        f"{name}: {len(raw) // file.size} words are not valid entries of {widths} words: damaged,"
        " or of an unknown release",
        file.path,
    )


def _layout(file: OP2File, parts: tuple[tuple[str, str, int], ...]) -> np.dtype[Any]:
    """Return the dtype of an entry of parts: name, kind (``i``, ``f``, 8-byte ``d``), number."""
    sizes = {"i": f"i{file.size}", "f": f"f{file.size}", "d": "f8"}
    return np.dtype([(name, file.order + sizes[kind], (n,)) for name, kind, n in parts])


def _grids(file: OP2File, raw: bytes) -> list[tuple[str, ...]]:
    """Return the fields of GRID cards: number, system, position, system of displacements."""
    layouts = tuple(
        _layout(file, (("ids", "i", 2), ("xyz", kind, 3), ("rest", "i", 3))) for kind in "fd"
    )

    def is_valid(entries: NumberArray) -> bool:
        ids, rest = entries["ids"], entries["rest"]
        return bool(
            (ids[:, 0] > 0).all()
            and (ids[:, 1] >= 0).all()
            and (rest[:, 0] >= -1).all()
            and ((rest[:, 1:] >= 0) & (rest[:, 1:] <= 99_999_999)).all()
            and np.isfinite(entries["xyz"]).all()
        )

    entries = _decode_entries(file, "GRID", raw, layouts, is_valid)
    return [
        (str(node), str(system), *map(repr, xyz), str(motion))
        for (node, system), xyz, (motion, _, _) in zip(
            entries["ids"].tolist(), entries["xyz"].tolist(), entries["rest"].tolist(), strict=True
        )
    ]


def _cord1(file: OP2File, raw: bytes) -> list[tuple[str, ...]]:
    """Return the fields of CORD1R and the like: number, three grids."""

    def is_valid(entries: NumberArray) -> bool:
        return bool((entries["all"][:, [0, 3, 4, 5]] > 0).all())

    entries = _decode_entries(file, "CORD1", raw, (_layout(file, (("all", "i", 6),)),), is_valid)
    return [tuple(map(str, row)) for row in entries["all"][:, [0, 3, 4, 5]].tolist()]


def _cord2(file: OP2File, raw: bytes) -> list[tuple[str, ...]]:
    """Return the fields of CORD2R and the like: number, reference system, three points."""
    layouts = tuple(_layout(file, (("ids", "i", 4), ("points", kind, 9))) for kind in "fd")

    def is_valid(entries: NumberArray) -> bool:
        ids = entries["ids"]
        return bool(
            (ids[:, 0] > 0).all()
            and (ids[:, 3] >= 0).all()
            and (ids[:, 2] == 2).all()
            and np.isfinite(entries["points"]).all()
        )

    entries = _decode_entries(file, "CORD2", raw, layouts, is_valid)
    return [
        (str(ids[0]), str(ids[3]), *map(repr, points))
        for ids, points in zip(entries["ids"].tolist(), entries["points"].tolist(), strict=True)
    ]


def _elements(
    file: OP2File, entry: _Entry, raw: bytes, grids: set[int]
) -> Iterator[tuple[str, ...]]:
    """Yield the fields of element cards: number and grids, at their places on the card."""
    layouts = tuple(_layout(file, (("all", "i", width),)) for width in entry.widths)
    known = np.array([0, *sorted(grids)])

    def is_valid(entries: NumberArray) -> bool:
        whole = entries["all"]
        return bool(
            (whole[:, 0] > 0).all()
            and np.isin(whole[:, list(entry.grids)], known).all()
            and whole[:, list(entry.grids)].any(axis=1).all()
        )

    entries = _decode_entries(file, entry.name, raw, layouts, is_valid)["all"]
    places = ELEMENTS[entry.name].nodes
    for row in entries.tolist():
        fields = [""] * (places[-1] + 1)
        fields[0] = str(row[0])
        for place, word in zip(places, entry.grids, strict=True):
            if row[word]:
                fields[place] = str(row[word])
        yield tuple(fields)
