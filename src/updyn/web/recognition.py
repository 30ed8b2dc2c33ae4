"""`recognise`: whether a file is a model, a measurement or a job, by its content."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from updyn.errors import FormatError, InputError, UpdynWarning
from updyn.io import read_model
from updyn.io.formats import find_format
from updyn.job.proposal import is_job
from updyn.text_table import format_count
from updyn.web.table_preview import view_measurement, without_path

__all__ = ["Kind", "Recognised", "recognise"]

#: "table": columns or variables from which FRFs have to be selected; "": none of these.
Kind = Literal["job", "model", "measurement", "table", ""]


@dataclass(frozen=True, slots=True)
class Recognised:
    """The kind of a file, and a summary of its content, or why it is of no kind."""

    kind: Kind
    text: str


def recognise(path: Path) -> Recognised:
    """Return the kind of a file by the readers, as `updyn new` does."""
    if is_job(path):
        return Recognised("job", "a job")
    measured = view_measurement(path, {})
    if not measured.error:
        return Recognised("measurement", measured.summary)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)
            model = read_model(path)
    except InputError as error:
        if measured.has_items:
            return Recognised("table", "a table: select its FRFs")
        if _has_format(path, "read_model"):
            return Recognised("", without_path(error, path))
        if _has_format(path, "read_frf"):
            return Recognised("", measured.error)
        return Recognised("", "neither a model nor a measurement nor a job")
    groups = format_count(len(model.groups), "group")
    return Recognised("model", f"{model.n_dofs:,} DOFs in {groups}")


def _has_format(path: Path, verb: str) -> bool:
    """Return whether a format that has a reader of this kind fits a file."""
    try:
        find_format(path, verb)
    except FormatError:
        return False
    return True
