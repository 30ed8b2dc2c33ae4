"""Natural frequencies as a text table: one test per line, or one mode per line.

Without a header, each line is one test and each column one mode, in Hz; an empty cell or ``nan`` is
a mode that the test did not find. A single column is one test with one mode per line. With a
header, each line is one mode.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.errors import AbsentError, FormatError, OptionError, suggest
from updyn.io.atomic import atomic_path
from updyn.io.csv_text import check_comments, plain_numbers
from updyn.io.items import locate_errors, read_utf8, require_file
from updyn.io.text_numbers import check_last_line, parse_real
from updyn.modal import ModeSet, RepeatedTests
from updyn.units import find_unit

__all__ = ["holds_frequencies", "read_modes", "write_modes"]


#: Names of columns, and whether their numbers are frequencies.
_COLUMNS = {
    "frequency": True,
    "std_frequency": True,
    "damping": False,
    "std_damping": False,
    "loss_factor": False,
    "std_loss_factor": False,
}
#: Column of the covariance with a mode, whose number is from 1, in Hz^2.
_COVARIANCE = re.compile(r"cov_frequency_(\d+)")
_HEADER = re.compile(r"(\w+)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))?")
#: [1] Values at critical damping. Why: a loss factor is twice the damping ratio.
_CRITICAL = {"damping": 1.0, "loss_factor": 2.0}
#: Units of fractions: name, factor.
_SHARES = {"": 1.0, "-": 1.0, "1": 1.0, "%": 0.01}
_COMMENT = re.compile(rb"(?:#.*)?")
_REMEDY = "state units in the header, such as 'frequency [Hz]'"


def read_modes(
    path: str | Path, *, test: int | None = None, modes: Sequence[int] | None = None
) -> ModeSet:
    """Read natural frequencies, by default the mean over the tests that found the mode.

    The standard deviation is that of the mean. An `AbsentError` is raised for another table.
    """
    text = read_utf8(require_file(path)).replace("\r\n", "\n")
    check_last_line(text, path, harmless=_COMMENT)
    lines = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    check_comments([one for one in lines if one[1].startswith("#")], (), _REMEDY, path)
    lines = [one for one in lines if not one[1].startswith("#")]
    if not lines:
        raise FormatError("no line of numbers", path)
    separator, first = _cells(lines[0][1])
    if not _is_row(first):
        return _modes_by_line(first, lines, separator, test, modes, path)
    table = _numbers(lines, len(first), separator, path)
    if table.shape[1] == 1:
        table = table.T
    return _select_test(table, test, modes, path)


def holds_frequencies(line: str) -> bool:
    """Return whether the first line of a table belongs to a table of natural frequencies."""
    _, cells = _cells(line)
    kinds = _kinds(cells)
    others = {kind for kind in kinds - _COLUMNS.keys() if not _COVARIANCE.fullmatch(kind)}
    return _is_row(cells) or ("frequency" in kinds and not others)


def _kinds(cells: Sequence[str]) -> set[str]:
    """Return the names of columns in the cells of a header, without units."""
    found = [_HEADER.fullmatch(cell) for cell in cells]
    return {
        cell if one is None else one[1].casefold() for cell, one in zip(cells, found, strict=True)
    }


def _cells(line: str) -> tuple[str, list[str]]:
    """Return the separator of a table and the cells of its first line."""
    separator = next((sign for sign in "\t;" if sign in line), ",")
    return separator, [cell.strip().strip('"') for cell in line.split(separator)]


def _is_row(cells: Sequence[str]) -> bool:
    """Return whether cells are numbers or empty, rather than names."""
    return not any(re.match(r"[^\W\d_]", cell) and cell.lower() != "nan" for cell in cells)


def _modes_by_line(
    names: list[str],
    lines: Sequence[tuple[int, str]],
    separator: str,
    test: int | None,
    modes: Sequence[int] | None,
    path: str | Path,
) -> ModeSet:
    if test is not None:
        raise OptionError(
            f"test={test!r}: this file holds one test, with one mode per line", key=("test",)
        )
    if not _kinds(names) & _COLUMNS.keys():
        raise AbsentError(
            f"header: column {names[0]!r}; expected columns of natural frequencies, such as"
            " 'frequency [Hz]'",
            path,
            lines[0][0],
        )
    columns = [_column(cell, path, lines[0][0]) for cell in names]
    kinds = [kind for kind, _ in columns]
    twice = {kind for kind in kinds if kinds.count(kind) > 1}
    both = {"damping", "loss_factor"} <= {kind.removeprefix("std_") for kind in kinds}
    if twice or both or "frequency" not in kinds:
        wrong = "'frequency' is missing"
        if twice:
            wrong = f"{min(twice)!r} occurs twice"
        elif both:
            wrong = "damping and loss factors; state one of them"
        raise FormatError(f"header: {wrong}", path, lines[0][0])
    table = _numbers(lines[1:], len(columns), separator, path)
    if not len(table):
        raise FormatError("a header without lines of numbers", path, lines[0][0])
    values = {kind: table[:, i] * factor for i, (kind, factor) in enumerate(columns)}
    _check_damping(values, lines[1:], path)
    for kind in ("damping", "std_damping"):
        if kind in values:
            values[kind.replace("damping", "loss_factor")] = 2.0 * values.pop(kind)
    number = _parse_modes(modes, len(table))
    covariance = _pop_covariance(values, path, lines[0][0])
    with locate_errors(path):
        chosen: dict[str, Any] = {kind: value[number] for kind, value in values.items()}
        if covariance is not None:
            chosen["cov_frequency"] = covariance[np.ix_(number, number)]
        return ModeSet(source=Path(path).name, **chosen)


def _check_damping(
    values: Mapping[str, RealArray], lines: Sequence[tuple[int, str]], path: str | Path
) -> None:
    """Refuse critical damping, which is probably in per cent without a unit."""
    for kind in values.keys() & _CRITICAL.keys():
        too_large = np.flatnonzero(values[kind] >= _CRITICAL[kind])
        if len(too_large):
            raise FormatError(
                f"{kind} {values[kind][too_large[0]]:g} is at or above critical damping; for per"
                f" cent name the column '{kind} [%]'",
                path,
                lines[too_large[0]][0],
            )


def _pop_covariance(values: dict[str, RealArray], path: str | Path, line: int) -> RealArray | None:
    """Remove the columns of the covariance from those of a table, and return them as a matrix."""
    names = [kind for kind in values if _COVARIANCE.fullmatch(kind)]
    if not names:
        return None
    n = len(values["frequency"])
    expected = [f"cov_frequency_{k + 1}" for k in range(n)]
    if set(names) != set(expected):
        raise FormatError(
            f"header: {len(names)} columns of the covariance, such as {names[-1]!r}; expected a"
            f" column for each of the {n} modes, 'cov_frequency_1' to {expected[-1]!r}",
            path,
            line,
        )
    return np.stack([values.pop(name) for name in expected], axis=1)


def _select_test(
    table: RealArray, test: int | None, modes: Sequence[int] | None, path: str | Path
) -> ModeSet:
    """Return the modes of one test, or the means over all tests."""
    n_tests, name = len(table), Path(path).name
    number = _parse_modes(modes, table.shape[1])
    if test is not None:
        if isinstance(test, bool) or not isinstance(test, int) or not 1 <= test <= n_tests:
            raise OptionError(
                f"test={test!r}: expected a number from 1 to {n_tests}", key=("test",)
            )
        table = table[test - 1 : test]
        name += f", test {test} of {n_tests}"
    table = table[:, number]
    count = np.isfinite(table).sum(axis=0)
    if modes is not None and not count.all():
        missing = int(number[np.argmin(count)]) + 1
        raise OptionError(f"modes: no test found mode {missing}", key=("modes",))
    table = table[:, count > 0]
    if not table.size:
        raise FormatError("no test found a mode", path)
    with locate_errors(path):
        if len(table) == 1:
            return ModeSet(table[0], source=name)
        name += f", mean of up to {count.max()} of {n_tests} tests"
        return RepeatedTests(table).mean_modes(name)


def _parse_modes(modes: Sequence[int] | None, number: int) -> IndexArray:
    """Return the positions of the modes of an option, from 0."""
    if modes is None:
        return np.arange(number)
    chosen = list(modes) if isinstance(modes, Sequence) and not isinstance(modes, str) else None
    whole = chosen is not None and all(
        isinstance(k, int) and not isinstance(k, bool) and 1 <= k <= number for k in chosen
    )
    if chosen is None or not chosen or not whole or len(set(chosen)) < len(chosen):
        raise OptionError(
            f"modes={modes!r}: expected numbers from 1 to {number}, each once", key=("modes",)
        )
    return np.array(chosen, dtype=np.intp) - 1


def _column(cell: str, path: str | Path, line: int) -> tuple[str, float]:
    """Return the kind of a column and the factor of its numbers, from its cell in the header."""
    found = _HEADER.fullmatch(cell)
    kind = "" if found is None else found[1].casefold()
    is_covariance = _COVARIANCE.fullmatch(kind) is not None
    if found is None or not (kind in _COLUMNS or is_covariance):
        raise FormatError(
            f"header: column {cell!r}; {suggest(kind or cell, list(_COLUMNS))}", path, line
        )
    unit = (found[2] or found[3] or "").strip()
    if is_covariance:
        square = find_unit(unit.removesuffix("^2") or "Hz", "frequency")
        if square is None or not (unit == "" or unit.endswith("^2")):
            raise FormatError(
                f"header: unit {unit!r} of {kind!r}; expected the square of a unit of frequency,"
                " such as 'Hz^2'",
                path,
                line,
            )
        return kind, square.factor**2
    if not _COLUMNS[kind]:
        if unit not in _SHARES:
            raise FormatError(
                f"header: unit {unit!r} of {kind!r}; expected '%' or none", path, line
            )
        return kind, _SHARES[unit]
    known = find_unit(unit or "Hz", "frequency")
    if known is None:
        raise FormatError(
            f"header: unit {unit!r} of {kind!r}; expected a unit of frequency, such as 'Hz'",
            path,
            line,
        )
    return kind, known.factor


def _numbers(
    lines: Sequence[tuple[int, str]], width: int, separator: str, path: str | Path
) -> RealArray:
    """Return lines of numbers as a table, with NaN for empty cells and ``nan``."""
    if not lines:
        return np.zeros((0, width))
    plain = plain_numbers("\n".join(line for _, line in lines), separator).split("\n")
    table = np.full((len(lines), width), np.nan)
    for row, ((number, _), line) in enumerate(zip(lines, plain, strict=True)):
        cells = [cell.strip() for cell in line.split(separator)]
        if len(cells) != width:
            raise FormatError(
                f"{len(cells)} cells; expected {width}, as on the first line", path, number
            )
        for column, cell in enumerate(cells):
            if cell.lower() in ("", "nan"):
                continue
            try:
                table[row, column] = parse_real(cell)
            except ValueError as error:
                raise FormatError(
                    f"{error}; cells are separated by commas, semicolons or tabs", path, number
                ) from error
    return table


def write_modes(modes: ModeSet, path: str | Path) -> None:
    """Write natural frequencies with their covariance, and loss factors, one mode per line."""
    if modes.has_shapes:
        raise FormatError(
            "a table cannot hold mode shapes; write a universal file (.uff), or"
            " updyn.ModeSet(modes.frequency)",
            path,
        )
    units = {
        "frequency": " [Hz]",
        "std_frequency": " [Hz]",
        "loss_factor": "",
        "std_loss_factor": "",
    }
    known = [name for name in units if np.isfinite(getattr(modes, name)).any()]
    columns = [(f"{name}{units[name]}", getattr(modes, name)) for name in known]
    if modes.cov_frequency is not None:
        for k, column in enumerate(modes.cov_frequency, 1):
            columns.append((f"cov_frequency_{k} [Hz^2]", column))
    rows = zip(*(values.tolist() for _, values in columns), strict=True)
    lines = [",".join(title for title, _ in columns)]
    lines += [",".join("" if np.isnan(v) else repr(v) for v in row) for row in rows]
    with atomic_path(path) as new:
        new.write_text("\n".join(lines) + "\n", encoding="utf-8")
