"""Write FRFs as universal files: units, geometry, a binary dataset 58 for each pair of DOFs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import FormatError, UpdynWarning
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.uff.elements import element_lines

__all__ = [
    "MOTIONS",
    "SI_UNITS",
    "check_nodes",
    "geometry_chunks",
    "text_dataset",
    "whole_row",
    "write_frf",
]

#: Data type, and units of translations and rotations, by quantity.
MOTIONS = {
    "receptance": (8, "m", "rad"),
    "mobility": (11, "m/s", "rad/s"),
    "accelerance": (12, "m/s^2", "rad/s^2"),
    TRANSMISSIBILITY: (12, "m/s^2", "rad/s^2"),
}
_PAIRS_A_TRACE = 80  # at most 250 entries, three per pair
_WIDEST = 10**10  # node numbers have ten columns
_COLUMNS = 13  # width of abscissa minimum and increment
_DOUBLE = {2: 4, 5: 6}  # ordinate data type of double precision, by single precision
_ONE = f"{1.0:25.17E}".replace("E", "D")
_ZERO = f"{0.0:25.17E}".replace("E", "D")
#: Lines of a dataset 164 with SI units.
SI_UNITS = [f"{1:10d}{'SI units':<20}{2:10d}", _ONE * 3, _ZERO]


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a universal file of binary datasets 58 (58b), SI.

    Values are stored exactly, in single precision if this represents them. Evenly spaced lines are
    stored as minimum and increment if these reproduce every line to rounding. The damping of a
    window is refused; variance and number of averages are lost, with a warning.
    """
    if frf.decay:
        raise FormatError(
            f"the values include the damping of a window exp(-{frf.decay:g} t), which universal"
            " files cannot state; write .nc, .npz, .mat or .csv",
            path,
        )
    optional = ("variance", "averages", "base", "force", "level", "sweep", "excitation", "spectrum")
    lacking = [name for name in optional if getattr(frf, name) is not None]
    if lacking:
        warnings.warn(
            f"{path}: universal files cannot hold {' and '.join(lacking)}; written without",
            UpdynWarning,
            stacklevel=2,
        )
    check_nodes([*frf.responses, *frf.references], frf.geometry, path)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        for chunk in _chunks(frf, path):
            file.write(chunk)


def check_nodes(dofs: Sequence[Dof], geometry: Geometry | None, path: str | Path) -> None:
    """Refuse nodes that do not fit the columns, or are missing in the geometry."""
    nodes = {dof.node for dof in dofs}
    placed = nodes if geometry is None else set(geometry.nodes.tolist())
    for node in sorted(nodes | placed):
        if not -_WIDEST // 10 < node < _WIDEST:
            raise FormatError(f"node {node} does not fit the ten columns of a universal file", path)
    lacking = [dof for dof in dofs if dof.node not in placed]
    if lacking:
        raise FormatError(
            f"DOF {lacking[0]} is at a node missing in the geometry ({len(lacking)} such DOFs);"
            " complete the geometry, or write without it",
            path,
        )


def _chunks(frf: FRF, path: str | Path) -> Iterator[bytes]:
    yield text_dataset(164, SI_UNITS)
    if frf.geometry is not None:
        yield from geometry_chunks(frf.geometry, path)
    for j, reference in enumerate(frf.references):
        for i, response in enumerate(frf.responses):
            yield _function(frf, response, reference, frf.values[:, i, j])
            if frf.coherence is not None:
                yield _function(frf, response, reference, frf.coherence[:, i, j])


def text_dataset(number: int, lines: Sequence[str]) -> bytes:
    """Return a dataset of text lines."""
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""]).encode("ascii")


# -- geometry -----------------------------------------------------------------------------------
def geometry_chunks(geometry: Geometry, path: str | Path) -> Iterator[bytes]:
    """Yield the datasets of coordinate systems, nodes, trace lines and faces."""
    systems = np.zeros(len(geometry.nodes), dtype=np.int64)
    if geometry.axes is not None:
        distinct, which = np.unique(geometry.axes.reshape(-1, 9), axis=0, return_inverse=True)
        # System 0 is the global system; the others are numbered from 2.
        is_global = (distinct == np.eye(3).ravel()).all(axis=1)
        numbers = np.where(is_global, 0, np.arange(len(distinct)) + 2)
        systems = numbers[which.ravel()]
        lines = [whole_row(1), "NONE"]
        for number, axes in zip(numbers.tolist(), distinct.reshape(-1, 3, 3), strict=True):
            if number:
                lines += [whole_row(number, 0, 8), f"CS{number}"]
                lines += [_reals(row) for row in (*axes, np.zeros(3))]
        yield text_dataset(2420, lines)
    lines = []
    rows = zip(geometry.nodes.tolist(), systems.tolist(), geometry.xyz, strict=True)
    for node, system, xyz in rows:
        lines += [whole_row(node, 0, system, 8), _reals(xyz)]
    yield text_dataset(2411, lines)
    if (geometry.lines == 0).any():
        raise FormatError(
            "a trace line contains node 0, which means 'lift the pen' in a universal file", path
        )
    for number, start in enumerate(range(0, len(geometry.lines), _PAIRS_A_TRACE), 1):
        pairs = geometry.lines[start : start + _PAIRS_A_TRACE]
        # Node 0 lifts the pen between two pairs.
        entries = np.column_stack([pairs, np.zeros_like(pairs[:, 0])]).ravel()[:-1].tolist()
        lines = [whole_row(number, len(entries), 8), "NONE"]
        for i in range(0, len(entries), 8):
            lines.append(whole_row(*entries[i : i + 8]))
        yield text_dataset(82, lines)
    if len(geometry.faces):
        yield text_dataset(2412, list(element_lines(geometry.faces)))


def whole_row(*numbers: int) -> str:
    """Return whole numbers in ten columns each."""
    return "".join(f"{number:10d}" for number in numbers)


def _reals(row: Any) -> str:
    return "".join(f"{float(x):25.16E}" for x in row).replace("E", "D")


# -- functions ----------------------------------------------------------------------------------
def _function(frf: FRF, response: Dof, reference: Dof, y: NumberArray) -> bytes:
    is_frf = np.iscomplexobj(y)
    columns = [y.real, y.imag] if is_frf else [y]
    even = _even_spacing(frf.freq)
    if even is None:
        columns.insert(0, frf.freq)
        minimum = increment = f"{0.0:.5E}"
    else:
        minimum, increment = even
    table = np.column_stack(columns)
    with np.errstate(over="ignore"):
        single = bool((table == table.astype("<f4")).all())
    data = table.astype("<f4" if single else "<f8").tobytes()
    if is_frf:
        function, ordinate, title = 4, 5, f"H {response} / {reference}"
        motion, unit, angle = MOTIONS[frf.quantity]
        numerator = _axis(motion, "NONE", angle if _is_rotation(response) else unit)
        denominator = _axis(13, "NONE", "N m" if _is_rotation(reference) else "N")
        if frf.quantity == TRANSMISSIBILITY:
            function, title = 5, f"T {response} / {reference}"
            denominator = _axis(motion, "NONE", angle if _is_rotation(reference) else unit)
    else:
        function, ordinate, title = 6, 2, f"Coherence {response} / {reference}"
        numerator = denominator = _axis(0, "NONE", "NONE")
    if not single:
        ordinate = _DOUBLE[ordinate]
    texts = [
        title[:80],
        *["NONE"] * 4,
        (
            f"{function:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{_code(response)}"
            f" {'NONE':<10}{_code(reference)}"
        ),
        whole_row(ordinate, len(y), even is not None) + f"{minimum:>13}{increment:>13}{0.0:13.5E}",
        _axis(18, "Frequency", "Hz"),
        numerator,
        denominator,
        _axis(0, "NONE", "NONE"),
    ]
    head = f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    lines = ["    -1", head, *(text.ljust(80) for text in texts), ""]
    return "\n".join(lines).encode("ascii") + data + b"    -1\n"


def _is_rotation(dof: Dof) -> bool:
    return dof.direction.startswith("R")


def _code(dof: Dof) -> str:
    return f"{dof.node:10d}{dof.sign * (DIRECTIONS.index(dof.direction) + 1):4d}"


def _axis(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}"


def _even_spacing(freq: RealArray) -> tuple[str, str] | None:
    """Return minimum and increment as texts, or None if they do not reproduce the lines."""
    if len(freq) < 2:
        return None
    start, step = (
        _format_in_columns(freq[0]),
        _format_in_columns((freq[-1] - freq[0]) / (len(freq) - 1)),
    )
    again = float(start) + np.arange(len(freq)) * float(step)
    if (np.abs(again - freq) <= 4 * np.spacing(freq)).all():
        return start, step
    return None


def _format_in_columns(value: float) -> str:
    """Format a number with the most digits that leave a blank in the columns of minimum."""
    for digits in range(17, 0, -1):
        text = f"{value:.{digits}g}"
        if len(text) < _COLUMNS:
            is_real = "." in text or "e" in text
            return text if is_real else f"{text}."
    return f"{value:.5E}"
