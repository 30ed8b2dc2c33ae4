"""Time records as a table in text, one line a sample.

For instance::

    # hammer test, hit 1
    time,hammer [N],3:Z [g]
    0.0,0.1,-0.02
    0.001,35.2,0.31

Columns are separated by commas, semicolons or tabs; decimals have a point. The first line that does
not start with ``#`` has the names; a unit may follow in square brackets. ``time`` holds seconds;
``record``, where there is such a column, the number of the record, rows of one record together.
"""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError, OptionError, suggest
from updyn.io.items import existing, placed, utf8_text
from updyn.io.text_numbers import number_rows
from updyn.signals.records import Records, step_of

__all__ = ["read_records"]

_NAME = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\])?")
_RECORD = "record"


def read_records(
    path: str | Path, *, time: str | None = None, rate: float | None = None
) -> Records:
    """Read time records.

    Parameters
    ----------
    path : path
        The file, in UTF-8.
    time : str, optional
        Name of the column of times in s, by default "time".
    rate : float, optional
        Samples a second, of a table without times.

    Returns
    -------
    Records
        In the units of the header.

    Raises
    ------
    FormatError
        If the header or a line is not as described, or times are not evenly spaced.
    OptionError
        If there are times and a rate, or neither.
    """
    text = utf8_text(existing(path)).replace("\r\n", "\n")
    first, header, body = _split(text, path)
    separator = next((sign for sign in ("\t", ";") if sign in header), ",")
    names, units = _columns(header, separator, path, first)
    rows = number_rows(
        body.encode(),
        "r" * len(names),
        f"{len(names)} numbers, as the header has names",
        path,
        first + 1,
        separator=separator.encode(),
        comment=b"#",
    )
    if not len(rows):
        raise FormatError("a header, and no line of numbers", path, first)
    columns = dict(zip(names, rows.T, strict=True))
    numbers = columns.pop(_RECORD, np.ones(len(rows)))
    times = _times(columns, time, rate, path, first)
    spans = _spans(numbers, path)
    step = 1.0 / rate if rate is not None else _step(times, spans, path)
    if not columns:
        raise FormatError("no channel beside time and record", path, first)
    values = [[column[span] for column in columns.values()] for span in spans]
    with placed(path):
        return Records.of(
            values, step, list(columns), [units[name] for name in columns], Path(path).name
        )


def _split(text: str, path: str | Path) -> tuple[int, str, str]:
    """Return the line of the header, the header and what follows."""
    at = 0
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            return number, line, text[at + len(line) + 1 :]
        at += len(line) + 1
    raise FormatError("no header: expected names such as 'time,hammer [N],3:Z [g]'", path)


def _columns(
    header: str, separator: str, path: str | Path, line: int
) -> tuple[list[str], dict[str, str]]:
    """Return the names of the columns, and the units that they state."""
    names: list[str] = []
    units: dict[str, str] = {}
    for number, cell in enumerate(header.split(separator), 1):
        found = _NAME.fullmatch(cell.strip().strip('"').strip())
        name = found[1] if found is not None else ""
        if found is None or not name:
            raise FormatError(
                f"header: column {number} is {cell.strip()[:40]!r}; expected a name, and a unit in"
                " square brackets if any",
                path,
                line,
            )
        if name in units:
            raise FormatError(f"header: column {name!r} stands twice", path, line)
        names.append(name)
        units[name] = (found[2] or "").strip()
    return names, units


def _times(
    columns: dict[str, NDArray[np.float64]],
    time: str | None,
    rate: float | None,
    path: str | Path,
    line: int,
) -> NDArray[np.float64]:
    """Take the times out of the columns; empty where a rate stands in their place."""
    name = "time" if time is None else time
    if rate is not None:
        if not (np.isfinite(rate) and rate > 0.0):
            raise OptionError(f"rate {rate!r}: expected samples a second, above 0", key=("rate",))
        if time is not None or name in columns:
            raise OptionError(
                f"rate and a column {name!r} of times; expected one of the two", key=("rate",)
            )
        return np.empty(0)
    if name not in columns:
        raise FormatError(
            f"no column {name!r} of times; {suggest(name, columns)} give time= or rate=",
            path,
            line,
            key=("time",) if time is not None else (),
        )
    return columns.pop(name)


def _spans(numbers: NDArray[np.float64], path: str | Path) -> list[slice]:
    """Return the rows of each record."""
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    spans = [slice(a, b) for a, b in pairwise(edges)]
    seen: set[float] = set()
    lengths = {span.stop - span.start for span in spans}
    for span in spans:
        number = float(numbers[span.start])
        if number in seen or number != round(number):
            raise FormatError(
                f"record {number:g}: expected whole numbers, rows of one record together", path
            )
        seen.add(number)
    if len(lengths) > 1:
        raise FormatError(
            f"records of {min(lengths)} to {max(lengths)} samples; records of a file have to be"
            " alike",
            path,
        )
    return spans


def _step(times: NDArray[np.float64], spans: list[slice], path: str | Path) -> float:
    """Return the step of the times, the same in all records."""
    with placed(path, "time"):
        steps = [step_of(times[span]) for span in spans]
    for number, step in enumerate(steps, 1):
        if abs(step - steps[0]) > 1e-6 * steps[0]:
            raise FormatError(
                f"record {number} has {step:g} s between samples, the first {steps[0]:g} s", path
            )
    return steps[0]
