"""FRFs as a text table with one line per frequency.

Columns are ``freq_Hz`` and ``H(RESPONSE/REFERENCE) KIND``, where KIND is ``re``, ``im``, ``abs``,
``phase_deg``, ``coh`` (ordinary coherence) or ``var`` (variance). Comments that state a unit or a
scale that is not read are refused. `updyn.io.csv_records` reads time records, `updyn.io.csv_modes`
natural frequencies.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import AbsentError, DofError, FormatError, OptionError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.csv_columns import read_columns
from updyn.io.csv_modes import holds_frequencies, read_modes, write_modes
from updyn.io.csv_proposal import propose_columns
from updyn.io.csv_records import read_records
from updyn.io.csv_text import (
    EXCITATION,
    UNITS,
    Comments,
    check_comments,
    comment,
    plain_numbers,
    read_averages,
    read_decay,
    read_excitation,
    single_comment,
    split_axis,
)
from updyn.io.dof_table import read_geometry
from updyn.io.items import check_phase, locate_errors, read_utf8
from updyn.io.ratio import Ratio
from updyn.io.text_numbers import check_last_line, parse_real
from updyn.units import find_unit, split_ratio

__all__ = [
    "read_frf",
    "read_geometry",
    "read_modes",
    "read_records",
    "write_frf",
    "write_modes",
]

_COLUMN = re.compile(r"H\(([^/,;()]+)[/,]([^/,;()]+)\)\s+([^\s\[(]+)(?:\s*(?:\[(.*)\]|\((.*)\)))?")
_WHAT = ("re", "im", "abs", "phase_deg", "coh", "var")
_OPTIONAL = {"coh": "coherence", "var": "variance"}
_COMMENT = re.compile(rb"(?:#.*)?")
#: Names of comments with a meaning.
_KNOWN = ("quantity", "averages", "source", "decay", *EXCITATION, *UNITS)
#: Names of the first column.
_FREQ = ("freq", "frequency", "f")
#: Accepted units of columns whose kind defines the unit, and the expected unit for messages.
_PLAIN = {
    "phase_deg": (("deg", "degree", "degrees", "°"), "deg"),
    "coh": (("-", "1"), "none: a coherence has no unit"),
}
_Pair = tuple[Dof, Dof]


@dataclass(frozen=True, slots=True)
class _FRFColumn:
    """A column after the first: its pair, its kind, its unit (empty if not stated) and its name."""

    pair: _Pair
    kind: str
    unit: str
    name: str


@dataclass(frozen=True, slots=True)
class _Header:
    """The line of names; `frequency` is the factor of the first column to Hz."""

    separator: str
    frequency: float
    columns: list[_FRFColumn]


def read_frf(
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    real_valued: bool = False,
    columns: Mapping[str, object] | None = None,
) -> FRF:
    """Read FRFs from a table, by its header or by `columns` (`updyn.io.csv_columns`)."""
    if duplicates != "raise":
        raise OptionError(
            f"duplicates={duplicates!r}: columns are unique in this format; expected 'raise'"
        )
    if columns is not None:
        return read_columns(path, columns, quantity=quantity, real_valued=real_valued)
    try:
        return _read_by_header(path, quantity, real_valued)
    except FormatError as error:
        proposal = propose_columns(path, error)
        if proposal is None:
            raise
        raise proposal from error


def _read_by_header(path: str | Path, quantity: str | None, real_valued: bool) -> FRF:
    """Read FRFs from a table whose header names the channels."""
    text = read_utf8(path).replace("\r\n", "\n")
    check_last_line(text, path, harmless=_COMMENT)
    head, lines = _split_head(text, path)
    number, names = lines[0]
    if holds_frequencies(names):
        raise AbsentError(
            "a table of natural frequencies (read it with updyn.read_modes, or [test] modes in a"
            " job), not of FRFs",
            path,
            number,
        )
    header = _parse_header(names, path, number)
    unit = _unit(head, path)
    table = _parse_table(lines[1:], header, path)
    rows, references = _responses_and_references(header.columns, path, number)
    _check_complete(header.columns, rows, references, real_valued, path, number)
    units = _units(header.columns, unit, path, number)
    arrays = _arrays(header.columns, units, table[:, 1:], rows, references, path)
    check_phase(arrays["values"], real_valued, "the table", path)
    with locate_errors(path):
        return FRF(
            table[:, 0],
            arrays["values"],
            rows,
            references,
            _quantity(head, quantity, units, path),
            coherence=arrays.get("coherence"),
            variance=arrays.get("variance"),
            averages=read_averages(head, path),
            source="\n".join(value for _, value in head.get("source", [])),
            decay=read_decay(head, path),
            **read_excitation(head, path),
        )


def _split_head(text: str, path: str | Path) -> tuple[Comments, list[tuple[int, str]]]:
    """Return the values of comments by name, and the other lines by number, header first."""
    head: Comments = {}
    lines, comments = [], []
    for number, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith("#"):
            comments.append((number, line))
        elif line.strip():
            lines.append((number, line))
    check_comments(comments, _KNOWN, "write '# unit: g/N', or units in the header", path)
    for number, line in comments:
        stated = comment(line)
        if stated is not None and stated[0] in _KNOWN:
            name = "unit" if stated[0] in UNITS else stated[0]
            head.setdefault(name, []).append((number, stated[1]))
    if not lines:
        raise FormatError("no header: expected a line that starts with 'freq_Hz'", path)
    return head, lines


def _parse_header(header: str, path: str | Path, line: int) -> _Header:
    separator = next((sign for sign in (";", "\t") if sign in header), ",")
    # A name such as H(3:Z,1:X) may contain the separator, so commas in brackets do not separate.
    parts = re.split(re.escape(separator) + r"(?![^(]*\))", header)
    cells = [part.strip().strip('"').strip() for part in parts]
    freq = split_axis(cells[0], _FREQ, "frequency")
    if freq is None:
        raise AbsentError(
            f"header: the first column is {cells[0][:40]!r}; expected 'freq_Hz'", path, line
        )
    unit = find_unit(freq[1], "frequency")
    assert unit is not None
    if not cells[1:]:
        raise FormatError(
            "header: no column after 'freq_Hz'; expected names such as 'H(3:Z/1:X) re'", path, line
        )
    columns: dict[tuple[_Pair, str], _FRFColumn] = {}
    for cell in cells[1:]:
        column = _parse_column(cell, path, line)
        if (column.pair, column.kind) in columns:
            raise FormatError(f"header: column {cell!r} occurs twice", path, line)
        columns[column.pair, column.kind] = column
    return _Header(separator, unit.factor, list(columns.values()))


def _parse_column(cell: str, path: str | Path, line: int) -> _FRFColumn:
    found = _COLUMN.fullmatch(cell)
    if found is None:
        raise FormatError(
            f"header: column {cell!r}; expected a name such as 'H(3:Z/1:X) re'", path, line
        )
    if found[3] not in _WHAT:
        raise FormatError(
            f"header: column {cell!r} is of kind {found[3]!r}; {suggest(found[3], _WHAT)}",
            path,
            line,
        )
    try:
        pair = (Dof.parse(found[1].strip()), Dof.parse(found[2].strip()))
    except DofError as error:
        raise FormatError(f"header: column {cell!r}: {error}", path, line) from error
    return _FRFColumn(pair, found[3], (found[4] or found[5] or "").strip(), cell)


_Units = dict[tuple[_Pair, str], Ratio | None]


def _unit(head: Comments, path: str | Path) -> Ratio | None:
    label = single_comment(head, "unit", path)
    return None if label is None else Ratio.of(label, "", path, head["unit"][0][0])


def _units(
    columns: Sequence[_FRFColumn], general: Ratio | None, path: str | Path, line: int
) -> _Units:
    """Return the units of the columns, all of one quantity; None for a column without unit."""
    out: _Units = {}
    quantities: dict[str, str] = {}
    for column in columns:
        column_unit = _column_unit(column, path, line)
        if column_unit is not None and general is not None and not column_unit.agrees(general):
            raise FormatError(
                f"header: column {column.name!r}: {column.unit!r} contradicts the comment, which"
                f" states {general.label!r}",
                path,
                line,
            )
        unit = column_unit or general
        if unit is not None:
            unit.check(column.pair, path, line)
            quantities.setdefault(unit.quantity, column.name)
        out[column.pair, column.kind] = unit
    if len(quantities) > 1:
        found_kinds = " and ".join(f"{name!r} of {kind}" for kind, name in quantities.items())
        raise FormatError(f"header: columns of several quantities: {found_kinds}", path, line)
    return out


def _column_unit(column: _FRFColumn, path: str | Path, line: int) -> Ratio | None:
    """Return the unit that a column states; None if it states none, or its kind defines it."""
    where, label = f"header: column {column.name!r}: ", column.unit
    if not label:
        return None
    if column.kind in _PLAIN:
        valid, expected = _PLAIN[column.kind]
        if label not in valid:
            raise FormatError(f"{where}unit {label!r}; expected {expected}", path, line)
        return None
    if column.kind != "var":
        return Ratio.of(label, where, path, line)
    square = re.fullmatch(r"\(?(.*?)\)?(?:\^2|²)", label)
    if square is None or split_ratio(square[1]) is None:
        raise FormatError(
            f"{where}unit {label!r}; expected the squared unit of the values, such as '(g/N)^2'",
            path,
            line,
        )
    return Ratio.of(square[1], where, path, line)


def _responses_and_references(
    columns: Sequence[_FRFColumn], path: str | Path, line: int
) -> tuple[DofSet, DofSet]:
    responses = {column.pair[0]: None for column in columns}
    references = {column.pair[1]: None for column in columns}
    try:
        return DofSet(responses), DofSet(references)
    except DofError as error:  # a DOF in both senses
        raise FormatError(f"header: {error}", path, line) from error


def _parse_table(lines: Sequence[tuple[int, str]], header: _Header, path: str | Path) -> RealArray:
    """Return the numbers, with the first column in Hz."""
    if not lines:
        raise FormatError("holds a header but no line of numbers", path)
    separator, width = header.separator, len(header.columns) + 1
    out = np.empty((len(lines), width))
    rows = plain_numbers("\n".join(line for _, line in lines), separator).split("\n")
    for i, ((number, _), row) in enumerate(zip(lines, rows, strict=True)):
        cells = row.split(separator)
        if len(cells) != width:
            hint = "; decimals have a point" if separator == "," and len(cells) > width else ""
            raise FormatError(f"{len(cells)} cell(s); expected {width}{hint}", path, number)
        out[i] = [_number(cell.strip(), j, path, number) for j, cell in enumerate(cells)]
        if i and out[i, 0] <= out[i - 1, 0]:
            raise FormatError(
                f"{out[i, 0]:g} Hz does not exceed {out[i - 1, 0]:g} Hz; lines must increase",
                path,
                number,
            )
    out[:, 0] *= header.frequency
    return out


def _number(cell: str, column: int, path: str | Path, line: int) -> float:
    try:
        return parse_real(cell)
    except ValueError as error:
        hint = ""
        if re.fullmatch(r"[+-]?\d+,\d+([eE][+-]?\d+)?", cell):
            hint = ": a decimal comma; decimals have a point"
        raise FormatError(
            f"column {column + 1}: {cell!r} is not a number{hint}", path, line
        ) from error


def _check_complete(
    columns: Sequence[_FRFColumn],
    rows: DofSet,
    references: DofSet,
    real_valued: bool,
    path: str | Path,
    line: int,
) -> None:
    """Refuse a table in which pairs of response and reference have different kinds of columns."""
    kinds: dict[_Pair, set[str]] = {}
    for column in columns:
        kinds.setdefault(column.pair, set()).add(column.kind)
    optional = [kind for kind in _OPTIONAL if any(kind in held for held in kinds.values())]
    forms = [["re", "im"], ["abs", "phase_deg"], *([["re"]] if real_valued else [])]
    for response in rows:
        for reference in references:
            held = kinds.get((response, reference), set())
            found = [kind for kind in _WHAT[:4] if kind in held]
            if found not in forms:
                raise _incomplete_error(f"H({response}/{reference})", found, path, line)
            for kind in optional:
                if kind not in held:
                    raise FormatError(
                        f"header: H({response}/{reference}) has no column {kind!r}, others have",
                        path,
                        line,
                    )


def _incomplete_error(name: str, found: Sequence[str], path: str | Path, line: int) -> FormatError:
    """Return the error for a pair whose columns do not form an FRF."""
    is_real = list(found) == ["re"]
    hint = ""
    if is_real:
        hint = "; if the values are real because their phase is 0 or pi, set real_valued=True"
    return FormatError(
        f"header: {name} has {' and '.join(found) or 'no column'}; expected re and im, or abs and"
        f" phase_deg, for every pair of response and reference{hint}",
        path,
        line,
        key=("real_valued",) if is_real else (),
    )


def _arrays(
    columns: Sequence[_FRFColumn],
    units: _Units,
    table: RealArray,
    rows: DofSet,
    references: DofSet,
    path: str | Path,
) -> dict[str, ComplexArray | RealArray]:
    """Return values, coherence and variance in SI units, each of shape (n_f, n_i, n_j)."""
    at = {}
    for column, values in zip(columns, table.T, strict=True):
        unit = units[column.pair, column.kind]
        if unit is None and column.kind == "var":  # use the stated unit of the values
            unit = units[column.pair, "re" if (column.pair, "re") in units else "abs"]
        if unit is not None and column.kind in ("re", "im", "abs"):
            values = values * unit.factor
        elif unit is not None and column.kind == "var":
            values = values * unit.factor**2
        at[column.pair, column.kind] = values
    shape = (len(table), len(rows), len(references))
    found = np.zeros(shape, dtype=np.complex128)
    extra = {kind: np.empty(shape) for kind in _OPTIONAL if any(c.kind == kind for c in columns)}
    for i, response in enumerate(rows):
        for j, reference in enumerate(references):
            pair = (response, reference)
            if (pair, "re") in at:
                found[:, i, j].real = at[pair, "re"]
                found[:, i, j].imag = at.get((pair, "im"), 0.0)
            else:
                found[:, i, j] = _polar(at[pair, "abs"], at[pair, "phase_deg"], pair, path)
            for kind in extra:
                extra[kind][:, i, j] = at[pair, kind]
    arrays: dict[str, ComplexArray | RealArray] = {"values": found}
    for kind, array in extra.items():
        arrays[_OPTIONAL[kind]] = array
    return arrays


def _polar(size: RealArray, degrees: RealArray, pair: _Pair, path: str | Path) -> ComplexArray:
    if (size < 0).any():
        raise FormatError(
            f"H({pair[0]}/{pair[1]}) abs is {size.min():g}; expected 0 or above", path
        )
    return np.asarray(size * np.exp(1j * np.deg2rad(degrees)))


def _quantity(head: Comments, given: str | None, units: _Units, path: str | Path) -> str:
    """Return the quantity stated by the file, its units or the user."""
    comment_value = single_comment(head, "quantity", path)
    unit = next((unit for unit in units.values() if unit is not None), None)
    by_unit = None if unit is None else unit.quantity
    if comment_value is not None and given is not None and comment_value != given:
        raise FormatError(
            f"quantity {given!r} contradicts the file, which states {comment_value!r}",
            path,
            key=("quantity",),
        )
    stated = given if comment_value is None else comment_value
    if unit is not None and stated is not None and stated != by_unit:
        raise FormatError(
            f"quantity {stated!r} contradicts the unit {unit.label!r} of {by_unit}",
            path,
            key=("quantity",) if comment_value is None else (),
        )
    stated = by_unit if stated is None else stated
    if stated is None:
        raise FormatError(
            "does not state the measured quantity: expected a line '# quantity: accelerance' (or"
            " mobility, receptance, transmissibility), or quantity= when reading",
            path,
        )
    return stated


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a table with real and imaginary parts, without loss of digits."""
    if frf.geometry is not None:
        warnings.warn(
            f"{path}: the table cannot hold the geometry; written without it",
            UpdynWarning,
            stacklevel=2,
        )
    head = [f"# quantity: {frf.quantity}"]
    if frf.averages is not None:
        head.append(f"# averages: {frf.averages}")
    if frf.decay:
        head.append(f"# decay: {frf.decay!r}")
    if frf.base is not None:
        head.append(f"# base: {' '.join(frf.base.labels)}")
    if frf.force is not None:
        head.append(f"# force: {frf.force}")
    if frf.level is not None:
        levels = frf.level[:1] if (frf.level == frf.level[0]).all() else frf.level
        head.append(f"# level: {' '.join(map(repr, levels.tolist()))}")
    if frf.sweep is not None:
        head.append(f"# sweep: {frf.sweep}")
    if frf.excitation is not None:
        head.append(f"# excitation: {frf.excitation}")
    if frf.spectrum is not None:
        rows = [f"{freq!r} {density!r}" for freq, density in frf.spectrum.tolist()]
        head.append(f"# spectrum: {'; '.join(rows)}")
    if frf.source:
        head += [f"# source: {line}" for line in frf.source.split("\n")]
    parts = {"re": frf.values.real, "im": frf.values.imag}
    for kind, name in _OPTIONAL.items():
        if getattr(frf, name) is not None:
            parts[kind] = getattr(frf, name)
    names = ["freq_Hz"]
    columns = [frf.freq]
    for j, reference in enumerate(frf.references):
        for i, response in enumerate(frf.responses):
            for kind, array in parts.items():
                names.append(f"H({response}/{reference}) {kind}")
                columns.append(array[:, i, j])
    body = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*head, ",".join(names), *body]) + "\n", encoding="utf-8")
