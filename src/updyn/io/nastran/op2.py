"""Nastran's OUTPUT2 files (.op2): geometry, modes and matrices.

Modes are of the table OUGV1 or OUG1 (MSC Nastran DMAP Programmer's Guide, data block OUG), real
(approach 2) or complex (approach 9), of one subcase, in the displacement directions of each node. A
direction that is zero in every mode is fixed. With the table LAMA the shapes are scaled to unit
modal mass; without it (MYSTRAN) the scale is unknown.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, IntArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import AbsentError, FormatError, InputError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.consistent_units import find_units
from updyn.io.items import format_counts, locate_errors
from updyn.io.nastran.deck import build_geometry
from updyn.io.nastran.matrices import OP2
from updyn.io.nastran.op2_cards import build_deck
from updyn.io.nastran.op2_file import OP2Block, OP2File
from updyn.io.settings import MEASURED_FILE
from updyn.modal import ModeSet
from updyn.model import Model

__all__ = ["Contents", "read_contents", "read_geometry", "read_model", "read_modes"]

_SHAPES = ("OUGV1", "OUG1")
_FREQUENCIES = "LAMA"
_IDENT = 146  # words
#: Words of the identification record of a mode, counted from 0.
_APPROACH, _TABLE, _SUBCASE, _MODE, _REAL, _IMAGINARY, _FORM, _WIDTH = 0, 1, 3, 4, 5, 6, 8, 9
_NORMAL, _COMPLEX = 2, 9
_APPROACHES = {
    1: "statics",
    5: "frequency response",
    6: "transient response",
    7: "buckling",
    8: "buckling",
    10: "non-linear statics",
}
_DISPLACEMENT, _EIGENVECTOR = 1, 7
#: Words of an entry: real, and real and imaginary parts.
_WIDTHS = {_NORMAL: 8, _COMPLEX: 14}
_MAGNITUDE_AND_PHASE = 3
_GRID, _SCALAR = 1, 2
_LAMA_WIDTH = 7
_LAMA_MODE, _LAMA_EIGENVALUE, _LAMA_MASS = 0, 2, 5


@dataclass(frozen=True, slots=True)
class Contents:
    """The content of an OUTPUT2 file.

    `matrices` has rows and columns of the assembled matrices, `element_blocks` the names of data
    blocks of element matrices, which are not read; `geometry` and `modes` may be the reason (str)
    why they were not read.
    """

    path: Path
    program: str
    tables: tuple[str, ...]
    matrices: dict[str, tuple[int, int]]
    element_blocks: tuple[str, ...]
    geometry: Geometry | str
    modes: ModeSet | str


@dataclass(frozen=True, slots=True, eq=False)
class _OP2Mode:
    """A mode, in the unit of the file."""

    subcase: int
    number: int
    value: complex  # (rad/s)^2 of a real mode, 1/s of a complex one
    approach: int
    nodes: IntArray
    kinds: IntArray
    shape: ComplexArray  # shape (n_nodes, 6)


def read_geometry(path: str | Path, *, unit: str = "m") -> Geometry:
    """Read the grid positions of an OUTPUT2 file in m; raise an `AbsentError` if it has none.

    Positions are in the basic system, with the displacement directions of grids that define them.
    """
    return build_geometry(build_deck(OP2File(path)), unit)


def read_modes(path: str | Path, *, unit: str = "m", subcase: int | None = None) -> ModeSet:
    """Read the modes of an OUTPUT2 file in SI; raise an `AbsentError` if it has none.

    DOFs are all nodes and directions that move in any mode. Shapes have unit modal mass if the file
    contains the modal masses.
    """
    return _modes(OP2File(path), unit, subcase)


def read_model(path: str | Path) -> Model:
    """Read the model of the matrices of a file, defined by the TOML file of the same name."""
    return OP2.read_model(path)


def read_contents(path: str | Path, *, unit: str = "m") -> Contents:
    """Read the content of an OUTPUT2 file: tables, matrices, geometry and modes."""
    find_units(unit)
    file = OP2File(path)
    matrices = {}
    for block in file.matrices:
        matrices[block.name] = (block.trailer[2], block.trailer[1])
    geometry: Geometry | str
    modes: ModeSet | str
    try:
        geometry = build_geometry(build_deck(file), unit)
    except InputError as error:
        geometry = _reason(error, path)
    try:
        modes = _modes(file, unit, None)
    except InputError as error:
        modes = _reason(error, path)
    of_elements = file.element_blocks
    is_table = [not block.is_matrix and block.name not in of_elements for block in file.blocks]
    tables = tuple(block.name for block in compress(file.blocks, is_table))
    return Contents(Path(path), file.program, tables, matrices, of_elements, geometry, modes)


def _reason(error: InputError, path: str | Path) -> str:
    return str(error).removeprefix(f"{path}:").strip()


# -- modes --------------------------------------------------------------------------------------
def _modes(file: OP2File, unit: str, subcase: int | None) -> ModeSet:
    units = find_units(unit)
    found: list[_OP2Mode] = []
    others = Counter[str]()
    for block in file.tables_named(*_SHAPES):
        for mode in _iterate_modes(file, block):
            if isinstance(mode, _OP2Mode):
                found.append(mode)
            else:
                others[mode] += 1
    if not found:
        held = ", ".join(dict.fromkeys(block.name for block in file.blocks)) or "nothing"
        also = f" with {format_counts(others)}" if others else ""
        raise AbsentError(
            "holds no modes (eigenvectors in the table OUGV1; Nastran writes it by PARAM,POST,-1"
            f" and DISPLACEMENT(PLOT) = ALL); it holds {held}{also}",
            file.path,
        )
    if others:
        warnings.warn(
            f"{file.path}: results other than modes are ignored: {format_counts(others)}",
            UpdynWarning,
            stacklevel=4,
        )
    chosen = _select_subcase(found, subcase, file.path)
    return _build_modes(file, chosen, units.length, np.sqrt(units.energy) / units.length)


def _iterate_modes(file: OP2File, block: OP2Block) -> Iterator[_OP2Mode | str]:
    """Yield the modes of a table, and a description of each other result."""
    if len(block.records) % 2:
        raise FormatError(
            f"{block.name}: {len(block.records)} records, expected two per mode", file.path
        )
    for head, body in zip(block.records[::2], block.records[1::2], strict=True):
        raw = file.data(head)
        whole, real = file.words(raw), file.words(raw, "f")
        if len(whole) != _IDENT:
            raise FormatError(
                f"{block.name}: a header of {len(whole)} words, expected {_IDENT}: damaged",
                file.path,
            )
        approach = int(whole[_APPROACH]) // 10
        order, table = divmod(int(whole[_TABLE]), 1000)
        if approach not in _WIDTHS:
            yield _APPROACHES.get(approach, f"approach {approach}")
            continue
        if table not in (_DISPLACEMENT, _EIGENVECTOR):
            yield f"table {table} of modes"
            continue
        mode = int(whole[_MODE])
        where = f"{block.name}, mode {mode}"
        if order not in (0, 1):
            raise FormatError(
                f"{where}: sorted by node (SORT2); expected by mode, DISPLACEMENT(SORT1,PLOT)",
                file.path,
            )
        width, form = int(whole[_WIDTH]), int(whole[_FORM])
        if width != _WIDTHS[approach] or form == _MAGNITUDE_AND_PHASE:
            raise FormatError(
                f"{where}: {width} words per node of format {form}; expected"
                f" {_WIDTHS[approach]}, real, or real and imaginary parts: DISPLACEMENT(REAL,PLOT)",
                file.path,
            )
        value = complex(real[_REAL], real[_IMAGINARY] if approach == _COMPLEX else 0.0)
        nodes, kinds, shape = _entries(file, file.data(body), width, where)
        yield _OP2Mode(int(whole[_SUBCASE]), mode, value, approach, nodes, kinds, shape)


def _entries(
    file: OP2File, raw: bytes, width: int, where: str
) -> tuple[IntArray, IntArray, ComplexArray]:
    """Return nodes, their types and the shape, (n, 6)."""
    if not raw or len(raw) % (width * file.size):
        raise FormatError(
            f"{where}: {len(raw) // file.size} words, expected {width} per node: damaged", file.path
        )
    whole = file.words(raw).reshape(-1, width)
    real = file.words(raw, "f").reshape(-1, width)[:, 2:].astype(np.float64)
    nodes = whole[:, 0].astype(np.int64) // 10
    if (nodes < 1).any():
        raise FormatError(f"{where}: an entry of node {nodes.min()}: damaged", file.path)
    if not np.isfinite(real).all():
        bad = nodes[~np.isfinite(real).all(axis=1)][0]
        raise FormatError(f"{where}: node {bad} has a number that is not finite", file.path)
    shape = real[:, :6].astype(np.complex128)
    if width == _WIDTHS[_COMPLEX]:
        shape += 1j * real[:, 6:]
    return nodes, whole[:, 1].astype(np.int64), shape


def _select_subcase(found: Sequence[_OP2Mode], subcase: int | None, path: Path) -> list[_OP2Mode]:
    """Return the modes of a subcase; refuse repeated modes."""
    known = sorted({mode.subcase for mode in found})
    if subcase is None and len(known) > 1:
        raise FormatError(
            f"holds modes of the subcases {', '.join(map(str, known))}; select one with the option"
            " subcase",
            path,
            key=("subcase",),
        )
    if subcase is not None and subcase not in known:
        raise FormatError(
            f"no modes of subcase {subcase}; {suggest(str(subcase), map(str, known))}",
            path,
            key=("subcase",),
        )
    chosen = [mode for mode in found if subcase is None or mode.subcase == subcase]
    first = chosen[0]
    for number, times in Counter(mode.number for mode in chosen).items():
        if times > 1:
            raise FormatError(
                f"mode {number} of subcase {first.subcase} occurs {times} times (superelements, or"
                " written twice); expected the modes of one structure",
                path,
            )
    for mode in chosen:
        if mode.approach != first.approach or not np.array_equal(mode.nodes, first.nodes):
            raise FormatError(
                f"modes {first.number} and {mode.number} of subcase {first.subcase} are not at the"
                " same nodes",
                path,
            )
    return chosen


def _build_modes(file: OP2File, found: list[_OP2Mode], length: float, mass: float) -> ModeSet:
    """Return the mode set; `length` is the unit in m, `mass` the root of the mass unit in kg."""
    first = found[0]
    if first.approach == _COMPLEX:
        # Keep the upper mode of each conjugate pair.
        found = [mode for mode in found if mode.value.imag > 0]
        if not found:
            raise FormatError("no complex mode oscillates", file.path)
        values = np.array([mode.value for mode in found])
        frequency = np.abs(values) / (2.0 * np.pi)
        loss = -2.0 * values.real / np.abs(values)
        factors = np.zeros(len(found))
    else:
        frequency = _frequencies(np.array([mode.value.real for mode in found]), file.path)
        loss = np.full(len(found), np.nan)
        factors = _factors(file, found)
    is_known = (first.kinds == _GRID) | (first.kinds == _SCALAR)
    if not is_known.all():
        kinds = Counter(f"of type {kind}" for kind in first.kinds[~is_known].tolist())
        warnings.warn(
            f"{file.path}: points that are neither grids nor scalar points are ignored:"
            f" {format_counts(kinds)}",
            UpdynWarning,
            stacklevel=5,
        )
    shapes = np.array([mode.shape for mode in found])[:, is_known]
    kinds_kept, nodes = first.kinds[is_known], first.nodes[is_known]
    # A scalar point has one number; the others of its entry are meaningless.
    shapes[:, kinds_kept == _SCALAR, 1:] = 0.0
    shapes[:, :, 3:] /= length
    shapes *= np.where(factors > 0, factors / mass, 1.0)[:, None, None]
    used = np.argwhere(shapes.any(axis=0))
    if not len(used):
        raise FormatError(f"the shape at {frequency[0]:g} Hz is zero at all points", file.path)
    with locate_errors(file.path):
        return ModeSet(
            frequency,
            shapes[:, used[:, 0], used[:, 1]].T,
            DofSet.from_arrays(nodes[used[:, 0]], used[:, 1]),
            loss,
            factors > 0,
            source=f"{file.path.name}, subcase {first.subcase}",
        )


def _frequencies(values: RealArray, path: Path) -> RealArray:
    """Return the frequencies in Hz of eigenvalues, 0 for eigenvalues negative by rounding."""
    if not np.isfinite(values).all():
        raise FormatError("an eigenvalue is not finite: damaged", path)
    size = np.sqrt(np.abs(values)) / (2.0 * np.pi)
    unstable = (values < 0) & (size > MEASURED_FILE.rigid_share * size.max())
    if unstable.any():
        warnings.warn(
            f"{path}: {unstable.sum()} modes have a negative eigenvalue, the lowest"
            f" {values.min():.6g}; their frequency is taken as 0 Hz",
            UpdynWarning,
            stacklevel=6,
        )
    return np.where(values > 0, size, 0.0)


def _factors(file: OP2File, found: Sequence[_OP2Mode]) -> RealArray:
    """Return the factors that scale shapes to unit modal mass; 0 if unknown."""
    masses: list[set[float]] = [set() for _ in found]
    for block in file.tables_named(_FREQUENCIES):
        for record in block.records[1::2]:
            raw = file.data(record)
            if len(raw) % (_LAMA_WIDTH * file.size):
                raise FormatError(
                    f"{block.name}: {len(raw) // file.size} words, expected {_LAMA_WIDTH} per mode:"
                    " damaged",
                    file.path,
                )
            whole = file.words(raw).reshape(-1, _LAMA_WIDTH)
            real = file.words(raw, "f").reshape(-1, _LAMA_WIDTH).astype(np.float64)
            rows = dict(zip(whole[:, _LAMA_MODE].tolist(), real, strict=True))
            if _belongs_to(rows, found):
                for mode_masses, mode in zip(masses, found, strict=True):
                    mode_masses.add(float(rows[mode.number][_LAMA_MASS]))
    # Two tables with equal eigenvalues but different masses belong to different normalizations.
    known = [mode_masses.pop() if len(mode_masses) == 1 else 0.0 for mode_masses in masses]
    return np.array([mass**-0.5 if mass > 0 else 0.0 for mass in known])


def _belongs_to(rows: dict[int, Any], found: Sequence[_OP2Mode]) -> bool:
    """Return whether a table of eigenvalues belongs to these modes."""
    for mode in found:
        if mode.number not in rows:
            return False
        eigenvalue = rows[mode.number][_LAMA_EIGENVALUE]
        value = mode.value.real
        if not abs(eigenvalue - value) <= MEASURED_FILE.eigenvalue_tolerance * abs(value):
            return False
    return True
