"""Functions in the text export of PULSE LabShop (Bruel & Kjaer), one in a file.

Layout, from two files of version 20 and three programs that read them::

    Header Size: 79             lines of names and values, separated by tabs
    Data Type: Complex          or Real
    X-Axis size: 6401           number of rows
    X-Axis unit: Hz
    AmplitudeUnit: m/s^2/N
    ...
    1  0.0  1.5e-3  -2.5e-4     number, abscissa, real and (if complex) imaginary part
    ...
    TagsBegin:                  and further lines
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from updyn.errors import FormatError

__all__ = ["isolate_rows"]

_START = "Header Size:"
_NEEDED = ("X-Axis size", "X-Axis unit", "Data Type")
_PARTS = {"Real": ("real",), "Complex": ("real", "imaginary")}


def isolate_rows(text: str, path: str | Path) -> str:
    """Return the rows below a line of names, all other lines blank; other texts unchanged."""
    if not text.startswith(_START):
        return text
    lines = text.split("\n")
    head = _read_head(lines)
    if not set(_NEEDED) <= set(head):
        return text
    names = _name_columns(head, path)
    count = _whole_number(head, "X-Axis size", path)
    if _whole_number({"Z-Axis size": "1", **head}, "Z-Axis size", path) != 1:
        raise FormatError("holds several functions along the Z axis; export each to a file", path)
    first = next((i for i, line in enumerate(lines) if _is_row(line, 1, len(names))), len(lines))
    for number in range(1, count + 1):
        at = first + number - 1
        if at >= len(lines) or not _is_row(lines[at], number, len(names)):
            raise FormatError(
                f"truncated or damaged: the header states {count} rows of {len(names)} columns; no"
                f" row {number}",
                path,
                min(at, len(lines) - 1) + 1,
            )
    rows = lines[first : first + count]
    kept = [*[""] * (first - 1), "\t".join(names), *(row.rstrip("\t ") for row in rows)]
    return "\n".join(kept) + "\n"


def _read_head(lines: Sequence[str]) -> dict[str, str]:
    head: dict[str, str] = {}
    for line in lines:
        name, separator, value = line.partition(":\t")
        if separator and name:
            head.setdefault(name, value.strip())
    return head


def _name_columns(head: Mapping[str, str], path: str | Path) -> list[str]:
    parts = _PARTS.get(head["Data Type"])
    if parts is None:
        raise FormatError(f"Data Type {head['Data Type']!r}; expected Real or Complex", path)
    label = head["X-Axis unit"]
    names = ["number", f"frequency [{label}]" if label == "Hz" else f"abscissa [{label}]"]
    unit = head.get("AmplitudeUnit", "")
    return names + [f"{part} [{unit}]" if unit else part for part in parts]


def _whole_number(head: Mapping[str, str], name: str, path: str | Path) -> int:
    text = head[name]
    if not text.isdecimal() or int(text) < 1:
        raise FormatError(f"{name} {text!r}; expected a whole number from 1", path)
    return int(text)


def _is_row(line: str, number: int, n_columns: int) -> bool:
    cells = line.rstrip("\t ").split("\t")
    return len(cells) == n_columns and cells[0].strip() == str(number)
