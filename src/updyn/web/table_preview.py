"""Content of the page about a table of FRFs, as plain data: read in a `Desk`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import RealArray
from updyn.errors import FormatError, InputError, UpdynWarning
from updyn.frf import FRF
from updyn.io import read_frf
from updyn.io.inventory import Inventory, list_items
from updyn.io.point_files import find_point_files, has_fields, propose_pattern
from updyn.job.proposal import read_guessed
from updyn.text_table import format_count
from updyn.web.settings import WEB_PAGE
from updyn.web.table_form import Key

__all__ = [
    "FRFPreview",
    "MeasurementView",
    "TableView",
    "preview_frf",
    "view_measurement",
    "view_table",
    "without_path",
]


@dataclass(frozen=True, slots=True)
class MeasurementView:
    """A measured file: `summary` of its FRFs, or the `error` of reading it.

    `has_items` states whether it has columns or variables from which FRFs can be selected,
    `has_quantity` whether the file or the options state the measured quantity.
    """

    summary: str
    error: str
    has_items: bool
    has_quantity: bool


@dataclass(frozen=True, slots=True, eq=False)
class FRFPreview:
    """FRFs as options select them, or the `errors` by key of the options.

    `freq`, shape (n_lines,), is in Hz; `values`, shape (n_lines, n_channels), in SI; `coherence` of
    the same shape, or None. `channels` has labels, response first.
    """

    errors: Mapping[Key, str] = field(default_factory=dict)
    summary: str = ""
    notes: tuple[str, ...] = ()
    quantity: str = ""
    channels: tuple[tuple[str, str], ...] = ()
    freq: RealArray = field(default_factory=lambda: np.empty(0))
    values: NDArray[np.complex128] = field(default_factory=lambda: np.empty((0, 0), complex))
    coherence: RealArray | None = None


@dataclass(frozen=True, slots=True)
class TableView:
    """The columns or variables of `first_file`; `pattern` matches the `n_files` of all points.

    Files are named without their folder; `pattern` is empty if there is one file.
    """

    inventory: Inventory
    first_file: str
    pattern: str = ""
    n_files: int = 0


def view_measurement(path: Path, options: Mapping[str, Any]) -> MeasurementView:
    """Describe a measured file, also if it does not state the measured quantity."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)
            read = read_guessed(path, dict(options))
    except InputError as error:
        return MeasurementView("", without_path(error, path), _has_items(path), True)
    quantity = f", {read.frf.quantity}" if read.has_quantity else ""
    guessed = read.options.keys() - options.keys()
    note = f"; {', '.join(guessed)} guessed from their names" if guessed else ""
    summary = f"{_describe(read.frf)}{quantity}{note}"
    return MeasurementView(summary, "", _has_items(path), read.has_quantity)


def view_table(path: Path, columns: Mapping[str, Any]) -> TableView:
    """Return the columns or variables of a file; InputError if it has none."""
    try:
        inventory = list_items(path, columns)
    except InputError as error:
        raise InputError(without_path(error, path)) from error
    pattern = path if has_fields(path) else propose_pattern(path)
    if pattern is None:
        return TableView(inventory, path.name)
    files = find_point_files(pattern)
    first = files[0].path if pattern == path else path
    return TableView(inventory, first.name, pattern.name, len(files))


def preview_frf(path: Path, options: Mapping[str, Any]) -> FRFPreview:
    """Return FRFs as options select them."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UpdynWarning)
            frf = read_frf(path, **options)
    except InputError as error:
        return FRFPreview({error.key: without_path(error, path)})
    notes = [str(w.message) for w in caught if issubclass(w.category, UpdynWarning)]
    n = min(len(frf.responses) * len(frf.references), WEB_PAGE.most_channels)
    pairs = [(str(i), str(j)) for i in frf.responses for j in frf.references]
    coherence = None if frf.coherence is None else frf.coherence.reshape(len(frf.freq), -1)[:, :n]
    return FRFPreview(
        {},
        _describe(frf),
        tuple(note.replace(str(path), path.name) for note in notes),
        frf.quantity,
        tuple(pairs[:n]),
        frf.freq,
        frf.values.reshape(len(frf.freq), -1)[:, :n],
        coherence,
    )


def _describe(frf: FRF) -> str:
    responses = format_count(len(frf.responses), "response")
    references = format_count(len(frf.references), "reference")
    lines = format_count(len(frf.freq), "line")
    return f"{responses}, {references}, {lines} from {frf.freq[0]:g} to {frf.freq[-1]:g} Hz"


def _has_items(path: Path) -> bool:
    try:
        return bool(list_items(path).items)
    except InputError:
        return False


def without_path(error: InputError, path: Path) -> str:
    """Return the message of an error with the name of the file in place of its path.

    Only the first line: the rest is about the text of a job.
    """
    text = str(error).splitlines()[0]
    if isinstance(error, FormatError) and error.path is not None:
        text = text.replace(f"{error.path}: ", "").replace(error.path, Path(error.path).name)
    return text.replace(str(path), path.name)
