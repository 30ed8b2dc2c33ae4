"""The columns or variables of a file from which FRFs can be selected, with a proposed mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from updyn.arrays import NumberArray
from updyn.errors import FormatError
from updyn.io.channels import Name
from updyn.io.csv_columns import find_stated_table
from updyn.io.csv_proposal import guess_columns, name_column
from updyn.io.csv_table import SEPARATORS, TextTable, format_cell
from updyn.io.formats import find_format, load
from updyn.io.frf_variables import VariableSource
from updyn.io.items import read_windows_text, require_file
from updyn.io.point_files import find_point_files, has_fields
from updyn.io.settings import FILE_TEXT
from updyn.io.variables_proposal import flatten, guess_variables

__all__ = ["Inventory", "Item", "list_items"]


@dataclass(frozen=True, slots=True)
class Item:
    """A column or a variable.

    `select` is its value in a mapping, `first` its first values as text, `size` its shape and kind
    as text, empty for columns of a table.
    """

    select: Name
    name: str
    unit: str
    first: str
    size: str = ""


@dataclass(frozen=True, slots=True)
class Inventory:
    """The items of a file; `option` is the option of `updyn.read_frf` that selects from them.

    `layout` describes the file in a sentence; `head` has the first lines of a text. `proposal` is
    the mapping by the names of the items, empty if unknown; ``"?"`` replaces unknown labels.
    """

    option: str
    layout: str
    items: tuple[Item, ...]
    proposal: Mapping[str, Any]
    head: tuple[str, ...] = ()


def list_items(path: str | Path, columns: Mapping[str, object] | None = None) -> Inventory:
    """Return the columns of a text table, or the variables of an npz, mat or HDF5 file.

    A file name with fields selects the first file. `columns` may have ``separator`` and
    ``first_row``; other keys are ignored. A `FormatError` is raised if the file cannot be read, or
    has neither columns nor variables.
    """
    if has_fields(path):
        files = find_point_files(path)
        path = files[0].path if files else path
    require_file(path)
    try:
        chosen = find_format(path, "read_source")
    except FormatError:
        return _list_columns(path, columns or {})
    return _list_variables(load(chosen).read_source(path))


def _list_columns(path: str | Path, columns: Mapping[str, object]) -> Inventory:
    text = read_windows_text(path)
    table = find_stated_table(text, path, columns)
    numbers = range(1, table.n_columns + 1)
    items = tuple(
        Item(name_column(table, n - 1), table.title(n), table.unit(n), _first_cells(table, n - 1))
        for n in numbers
    )
    names = "with names" if table.header else "without names"
    layout = (
        f"{len(table.rows)} rows from line {table.line(0)} in {table.n_columns} columns {names},"
        f" separated by {SEPARATORS[table.separator]}"
    )
    lines = text.split("\n", FILE_TEXT.first_lines)[: FILE_TEXT.first_lines]
    head = tuple(line[: FILE_TEXT.first_line_characters] for line in lines)
    return Inventory("columns", layout, items, guess_columns(table) or {}, head)


def _first_cells(table: TextTable, at: int) -> str:
    rows = table.rows[: FILE_TEXT.first_values]
    return ", ".join(format_cell(cells[at]) for _, cells in rows if at < len(cells))


def _list_variables(source: VariableSource) -> Inventory:
    arrays = flatten(source.found)
    items = [item for name, array in arrays.items() for item in _list_array(name, array, source)]
    layout = f"{len(arrays)} arrays of numbers"
    return Inventory("variables", layout, tuple(items), guess_variables(arrays) or {})


def _list_array(name: str, array: NumberArray, source: VariableSource) -> list[Item]:
    """Return an array, and its columns if it is a table of a few."""
    unit = source.unit(name)
    items = [Item(name, name, unit, _first_values(array), _format_size(array))]
    n_columns = array.shape[1] if array.ndim == 2 else 1
    if 1 < n_columns < array.shape[0] and n_columns <= FILE_TEXT.listed_columns:
        for at in range(n_columns):
            select = f"{name}(:,{at + 1})"
            items.append(Item(select, select, unit, _first_values(array[:, at]), "column"))
    return items


def _first_values(array: NumberArray) -> str:
    return ", ".join(f"{value:.6g}" for value in array.reshape(-1)[: FILE_TEXT.first_values])


def _format_size(array: NumberArray) -> str:
    kind = "complex" if array.dtype.kind == "c" else "real"
    return f"{' x '.join(map(str, array.shape)) or '1'} {kind}"
