"""FRFs as a table in text, one line a frequency.

For instance::

    # quantity: accelerance
    # averages: 12
    freq_Hz,H(3:Z/1:X) re,H(3:Z/1:X) im,H(3:Z/1:X) coh
    10.0,0.12,-0.03,0.98

Columns are separated by commas, semicolons or tabs; decimals have a point. The first column is
``freq_Hz``. The others are called ``H(RESPONSE/REFERENCE) WHAT``, in any order, WHAT being ``re``
and ``im``, or ``abs`` and ``phase_deg``, and optionally ``coh`` (ordinary coherence) and ``var``
(variance), for every pair of response and reference. Lines that start with ``#`` may stand before
the header; ``quantity:``, ``averages:``, ``source:`` and ``decay:`` in them are read. Time records
stand in a table of their own: `updyn.io.csv_records`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import Dof, DofSet
from updyn.errors import AbsentError, DofError, FormatError, OptionError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.io.atomic import atomic_path
from updyn.io.csv_records import read_records
from updyn.io.dof_table import read_geometry
from updyn.io.items import placed, utf8_text
from updyn.io.text_numbers import check_last_line, real_of

__all__ = ["read_frf", "read_geometry", "read_records", "write_frf"]

_COLUMN = re.compile(r"H\(([^/,;()]+)[/,]([^/,;()]+)\)\s+(\S+)")
_WHAT = ("re", "im", "abs", "phase_deg", "coh", "var")
_OPTIONAL = {"coh": "coherence", "var": "variance"}
_COMMENT = re.compile(rb"(?:#.*)?")
_HEAD = re.compile(r"#\s*(quantity|averages|source|decay)\s*:[ \t]?(.*)")
_Pair = tuple[Dof, Dof]


def read_frf(path: str | Path, *, quantity: str | None = None, duplicates: str = "raise") -> FRF:
    """Read FRFs from a table.

    Parameters
    ----------
    path : path
        The file, in UTF-8.
    quantity : str, optional
        What was measured, where the file does not say; a contradiction is an error.
    duplicates : {"raise"}
        For the sake of the other formats; a column stands once.

    Returns
    -------
    FRF
        What the table holds.

    Raises
    ------
    FormatError
        If the header or a cell is not as described; the message says on which line.
    """
    if duplicates != "raise":
        raise OptionError(
            f"duplicates={duplicates!r}: in this format a column stands once; only 'raise' applies"
        )
    text = utf8_text(path).replace("\r\n", "\n")
    check_last_line(text, path, harmless=_COMMENT)
    head, lines = _split_head(text, path)
    number, header = lines[0]
    separator = ","
    for other in ("\t", ";"):
        if other in header:
            separator = other
    columns = _columns(header, separator, path, number)
    table = _table(lines[1:], separator, len(columns) + 1, path)
    rows, references = _sides(columns, path, number)
    arrays = _arrays(columns, table[:, 1:], rows, references, path, number)
    with placed(path):
        return FRF(
            table[:, 0],
            arrays["values"],
            rows,
            references,
            _quantity(head, quantity, path),
            coherence=arrays.get("coherence"),
            variance=arrays.get("variance"),
            averages=_averages(head, path),
            source="\n".join(head.get("source", [])),
            decay=_decay(head, path),
        )


def _split_head(text: str, path: str | Path) -> tuple[dict[str, list[str]], list[tuple[int, str]]]:
    """Return what the comments say, and the other lines with their numbers, the header first."""
    head: dict[str, list[str]] = {}
    lines = []
    for number, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith("#"):
            found = _HEAD.fullmatch(line.lstrip())
            if found:
                head.setdefault(found[1], []).append(found[2])
        elif line.strip():
            lines.append((number, line))
    if not lines:
        raise FormatError("no header: expected a line that starts with 'freq_Hz'", path)
    return head, lines


def _columns(header: str, separator: str, path: str | Path, line: int) -> list[tuple[_Pair, str]]:
    """Return pair and kind of each column after the first."""
    # A name such as H(3:Z,1:X) may hold the separator, in quotes or not: commas in brackets do not
    # separate.
    parts = re.split(re.escape(separator) + r"(?![^(]*\))", header)
    cells = [part.strip().strip('"').strip() for part in parts]
    if cells[0] != "freq_Hz":
        raise AbsentError(
            f"header: the first column is {cells[0][:40]!r}; expected 'freq_Hz'", path, line
        )
    out: list[tuple[_Pair, str]] = []
    for cell in cells[1:]:
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
        if (pair, found[3]) in out:
            raise FormatError(f"header: column {cell!r} stands twice", path, line)
        out.append((pair, found[3]))
    if not out:
        raise FormatError(
            "header: no column after 'freq_Hz'; expected names such as 'H(3:Z/1:X) re'", path, line
        )
    return out


def _sides(
    columns: Sequence[tuple[_Pair, str]], path: str | Path, line: int
) -> tuple[DofSet, DofSet]:
    """Return the responses and the references, each in the order of the columns."""
    responses = {pair[0]: None for pair, _ in columns}
    references = {pair[1]: None for pair, _ in columns}
    try:
        return DofSet(responses), DofSet(references)
    except DofError as error:  # one DOF with both senses
        raise FormatError(f"header: {error}", path, line) from error


def _table(
    lines: Sequence[tuple[int, str]], separator: str, width: int, path: str | Path
) -> NDArray[np.float64]:
    if not lines:
        raise FormatError("holds a header and no line of numbers", path)
    out = np.empty((len(lines), width))
    for i, (number, line) in enumerate(lines):
        cells = line.split(separator)
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
    return out


def _number(cell: str, column: int, path: str | Path, line: int) -> float:
    try:
        return real_of(cell)
    except ValueError as error:
        hint = ""
        if re.fullmatch(r"[+-]?\d+,\d+([eE][+-]?\d+)?", cell):
            hint = ": a decimal comma; decimals have a point"
        raise FormatError(
            f"column {column + 1}: {cell!r} is not a number{hint}", path, line
        ) from error


def _arrays(
    columns: Sequence[tuple[_Pair, str]],
    table: NDArray[np.float64],
    rows: DofSet,
    references: DofSet,
    path: str | Path,
    line: int,
) -> dict[str, NDArray[np.complex128] | NDArray[np.float64]]:
    at = {column: table[:, i] for i, column in enumerate(columns)}
    kinds = {kind for _, kind in columns}
    shape = (len(table), len(rows), len(references))
    values = np.empty(shape, dtype=np.complex128)
    extra = {kind: np.empty(shape) for kind in _OPTIONAL if kind in kinds}
    for i, response in enumerate(rows):
        for j, reference in enumerate(references):
            pair = (response, reference)
            held = [kind for kind in _WHAT[:4] if (pair, kind) in at]
            if held not in (["re", "im"], ["abs", "phase_deg"]):
                raise FormatError(
                    f"header: H({response}/{reference}) has {' and '.join(held) or 'no column'};"
                    " expected re and im, or abs and phase_deg, for every pair of response and"
                    " reference",
                    path,
                    line,
                )
            if held[0] == "re":
                values[:, i, j].real = at[pair, "re"]
                values[:, i, j].imag = at[pair, "im"]
            else:
                values[:, i, j] = _polar(at[pair, "abs"], at[pair, "phase_deg"], pair, path)
            for kind in extra:
                if (pair, kind) not in at:
                    raise FormatError(
                        f"header: H({response}/{reference}) has no column {kind!r}, others have",
                        path,
                        line,
                    )
                extra[kind][:, i, j] = at[pair, kind]
    arrays: dict[str, NDArray[np.complex128] | NDArray[np.float64]] = {"values": values}
    for kind, array in extra.items():
        arrays[_OPTIONAL[kind]] = array
    return arrays


def _polar(
    size: NDArray[np.float64], degrees: NDArray[np.float64], pair: _Pair, path: str | Path
) -> NDArray[np.complex128]:
    if (size < 0).any():
        raise FormatError(
            f"H({pair[0]}/{pair[1]}) abs is {size.min():g}; expected 0 or above", path
        )
    return np.asarray(size * np.exp(1j * np.deg2rad(degrees)))


def _one(head: dict[str, list[str]], name: str, path: str | Path) -> str | None:
    found = set(map(str.strip, head.get(name, [])))
    if len(found) > 1:
        raise FormatError(f"{name} is said twice: {' and '.join(sorted(found))}", path)
    return found.pop() if found else None


def _quantity(head: dict[str, list[str]], given: str | None, path: str | Path) -> str:
    said = _one(head, "quantity", path)
    if said is None and given is None:
        raise FormatError(
            "does not say what was measured: expected a line '# quantity: accelerance' (or"
            " mobility, receptance), or quantity= when reading",
            path,
        )
    if said is not None and given is not None and said != given:
        raise FormatError(
            f"quantity {given!r} contradicts the file, which says {said!r}", path, key=("quantity",)
        )
    return str(given if said is None else said)


def _averages(head: dict[str, list[str]], path: str | Path) -> int | None:
    said = _one(head, "averages", path)
    if said is None:
        return None
    if not re.fullmatch(r"[0-9]+", said):
        raise FormatError(f"averages: {said!r}; expected a whole number of at least 1", path)
    return int(said)


def _decay(head: dict[str, list[str]], path: str | Path) -> float:
    said = _one(head, "decay", path)
    if said is None:
        return 0.0
    try:
        return real_of(said)
    except ValueError as error:
        raise FormatError(f"decay: {said!r}; expected a number in 1/s", path) from error


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a table with real and imaginary parts; every number is read back exactly.

    Parameters
    ----------
    frf : FRF
        The data.
    path : path
        File to write.

    Warns
    -----
    UpdynWarning
        If there is a geometry: the table has no place for it.
    """
    if frf.geometry is not None:
        warnings.warn(
            f"{path}: the table has no place for the geometry; written without it",
            UpdynWarning,
            stacklevel=2,
        )
    head = [f"# quantity: {frf.quantity}"]
    if frf.averages is not None:
        head.append(f"# averages: {frf.averages}")
    if frf.decay:
        head.append(f"# decay: {frf.decay!r}")
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
