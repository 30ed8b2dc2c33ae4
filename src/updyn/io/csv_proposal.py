"""A proposal of ``columns`` for a text table whose header does not follow the format.

The parts of the channels are guessed from the names of the columns; the user confirms them by
stating ``columns``. Without known names the proposal is an example with numbers of columns.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from updyn.errors import AbsentError, FormatError, InputError
from updyn.io.channels import FORMS, Name
from updyn.io.csv_table import TextTable, find_table
from updyn.io.items import is_file, read_windows_text
from updyn.io.toml_text import format_mapping

__all__ = [
    "FREQUENCY",
    "UNKNOWN",
    "WORDS",
    "guess_columns",
    "has_word",
    "name_column",
    "propose_columns",
]

#: Words of a frequency, and of the parts of a channel in the order of the search; those of three
#: letters or more are beginnings of words.
FREQUENCY = ("f", "hz", "freq", "frequenz", "omega")
WORDS = {
    "coherence": ("coh", "gamma", "kohärenz"),
    "imaginary": ("im", "imag"),
    "real": ("re", "real"),
    "magnitude_dB": ("db",),
    "phase_rad": ("rad",),
    "phase_deg": ("deg", "°"),
    "phase": ("phas", "angle", "arg", "phi", "winkel"),
    "magnitude": ("mag", "abs", "amp", "mod", "betrag"),
    "complex": ("complex", "cplx"),
}
#: Other columns of such tables.
_OTHER = ("time", "node", "record", "dof")
_WORD = re.compile(r"[^\W\d_]+|°")
#: A label such as ``3:-Z`` or ``3Z``, which no letter or digit precedes or follows.
_LABEL = re.compile(r"(?<![^\W_])([0-9]+)(?::|(?=R?[XYZ]))([+-]?R?[XYZ])(?![^\W_])")
#: In place of an unknown label.
UNKNOWN = "?"
#: Columns of the example, by number.
_EXAMPLE = {2: "real", 3: "imaginary"}


@dataclass(frozen=True, slots=True)
class _Guess:
    """The guessed part of a column, and the rest of its name, which it shares with its channel."""

    name: Name
    part: str
    rest: str
    labels: tuple[str, ...]


_Channel = Mapping[str, _Guess]


def propose_columns(path: str | Path, error: FormatError) -> FormatError | None:
    """Return an error with the columns of the table and a proposal of ``columns``, or None."""
    # It is None if the text is not a table, or has the names of the format. Without known names
    # there is a proposal only for an `AbsentError`.
    if not is_file(path):
        return None
    try:
        table = find_table(read_windows_text(path), path)
    except InputError:
        return None
    if table is None or any(cell.startswith("H(") for cell in table.header):
        return None
    proposal = guess_columns(table)
    kind: type[FormatError] = FormatError
    if proposal is None:
        if not isinstance(error, AbsentError) or not _resembles_frf(table):
            return None
        proposal = _make_example(table)
        # No other table of this format has blanks between its columns.
        kind = FormatError if table.separator == " " else AbsentError
    out = kind(
        f"{error}\nColumns with their first values: {table.format_columns()}\nIf they are FRFs,"
        " select them with columns in [test] of a job, --test-option of updyn new, or columns= of"
        " updyn.read_frf; correct the"
        f" labels, and state quantity:\ncolumns = {format_mapping(proposal)}",
        key=error.key,
    )
    out.path, out.line = error.path, error.line
    return out


def guess_columns(table: TextTable) -> dict[str, object] | None:
    """Return ``columns`` by the names of the columns; None if they name no complete channel."""
    frequency = _find_frequency(table)
    channels = [] if frequency is None else _find_channels(table, frequency)
    if frequency is None or not channels:
        return None
    return {"frequency": frequency, "channels": [_select(channel) for channel in channels]}


def _make_example(table: TextTable) -> dict[str, object]:
    """Return ``columns`` of one channel by numbers, as an example."""
    frequency = _find_frequency(table)
    channel = {part: _Guess(i, part, "", ()) for i, part in _EXAMPLE.items()}
    return {"frequency": 1 if frequency is None else frequency, "channels": [_select(channel)]}


def _select(channel: _Channel) -> dict[str, object]:
    """Return the table of a channel in ``columns``, with `UNKNOWN` for labels not in the names."""
    labels = next((one.labels for one in channel.values() if len(one.labels) in (1, 2)), ())
    response, reference = (*labels, UNKNOWN, UNKNOWN)[:2]
    names = {part: one.name for part, one in channel.items()}
    return {"response": response, "reference": reference, **names}


def _resembles_frf(table: TextTable) -> bool:
    """Return whether the first of three columns or more increases and may be a frequency."""
    if table.n_columns <= max(_EXAMPLE):
        return False
    if table.header and has_word(table.header[0], _OTHER):
        return False
    try:
        first = table.numbers(1, ())
    except FormatError:
        return False
    return bool((np.diff(first) > 0.0).all())


def has_word(name: str, stems: Iterable[str]) -> bool:
    """Return whether a name has a word, or for three letters or more the beginning of a word."""
    return any(_is_word(word, stems) for word in _WORD.findall(name.casefold()))


def _is_word(word: str, stems: Iterable[str]) -> bool:
    return any(word == stem or (len(stem) > 2 and word.startswith(stem)) for stem in stems)


def name_column(table: TextTable, at: int) -> Name:
    """Return the name of a column, or its number if the name is empty or not unique."""
    cell = table.header[at] if table.header else ""
    return cell if cell and table.header.count(cell) == 1 else at + 1


def _find_frequency(table: TextTable) -> Name | None:
    """Return the first column with the name of a frequency."""
    for at, cell in enumerate(table.header):
        if has_word(cell, FREQUENCY) and not any(has_word(cell, w) for w in WORDS.values()):
            return name_column(table, at)
    return None


def _find_channels(table: TextTable, frequency: Name) -> list[_Channel]:
    """Return the channels by the names of the columns; none if one of them is incomplete."""
    found: list[_Guess] = []
    for at, cell in enumerate(table.header):
        name = name_column(table, at)
        part = _find_part(table, at)
        if part is not None and name != frequency:
            labels = tuple(map(":".join, _LABEL.findall(cell)))
            found.append(_Guess(name, part, _find_rest(cell, table.unit(at + 1)), labels))
    for rests in ([one.rest for one in found], [""] * len(found)):
        channels = _group(found, rests)
        if channels and all(map(_is_complete, channels)):
            return channels
    return []


def _find_part(table: TextTable, at: int) -> str | None:
    """Return the part in a column, by its name, its unit and the size of a phase."""
    name = f"{table.header[at]} {table.unit(at + 1)}"
    for part, words in WORDS.items():
        if not has_word(name, words):
            continue
        if part != "phase":
            return part
        try:
            largest = np.abs(table.numbers(at + 1, ())).max()
        except FormatError:
            return None
        return "phase_deg" if largest > 2.0 * np.pi else "phase_rad"
    return "complex" if table.is_complex(at) else None


def _find_rest(cell: str, unit: str) -> str:
    """Return a name without the words of parts, its unit, and signs between words."""
    text = cell.replace(unit, "") if unit else cell
    stems = [stem for words in WORDS.values() for stem in words]
    text = _WORD.sub(lambda word: "" if _is_word(word[0].casefold(), stems) else word[0], text)
    return re.sub(r"[^\w:/,.+-]+|_", "", text).strip(":/,.+-")


def _group(found: Sequence[_Guess], rests: Sequence[str]) -> list[_Channel]:
    """Return the columns by the rest of their names; a repeated part starts another channel."""
    channels: list[_Channel] = []
    current: dict[str, dict[str, _Guess]] = {}
    for one, rest in zip(found, rests, strict=True):
        if rest not in current or one.part in current[rest]:
            current[rest] = {}
            channels.append(current[rest])
        current[rest][one.part] = one
    return channels


def _is_complete(channel: _Channel) -> bool:
    return any(set(channel) - {"coherence"} == set(form) for form in FORMS)
