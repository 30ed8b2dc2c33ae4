"""Files that a job names."""

from __future__ import annotations

from pathlib import Path

from updyn.errors import InputError, OptionError, key_path, suggest
from updyn.foreign.confinement import check_inside
from updyn.io.items import is_file, is_folder
from updyn.io.point_files import find_point_files, has_fields
from updyn.job.base import Document

__all__ = [
    "check_encodable",
    "existing_file",
    "existing_measurement",
    "is_encodable",
    "list_measured_files",
]


def is_encodable(name: str) -> bool:
    """Return whether the name of a file can be encoded in UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def check_encodable(name: str) -> None:
    """Raise `InputError` if the name of a file, as written in jobs and results, is not UTF-8."""
    if not is_encodable(name):
        raise InputError(
            f"{name}: the name is not UTF-8, and cannot be stated in a job or in results; rename it"
        )


def existing_measurement(job: Document, file: str, key: str) -> Path:
    """Return the path of a measurement named by ``test.key`` of a job, as `existing_file`.

    The path of a name with fields, for one file per measurement point, is returned as it is.
    """
    path = job.beside(file)
    if not has_fields(path):
        return existing_file(job, file, "test", key)
    with key_path("test", key):
        check_inside(path)
        for one in find_point_files(path):
            check_inside(one.path)
    return path


def list_measured_files(path: Path) -> list[Path]:
    """Return the files of a measurement: itself, or those that match a name with fields."""
    return [one.path for one in find_point_files(path)] if has_fields(path) else [path]


def existing_file(job: Document, file: str, table: str, key: str) -> Path:
    """Return the path of a file named by ``table.key`` of a job.

    An `OptionError` with the nearest name is raised if it is not an existing file, an `InputError`
    if it is outside the folder to which this process is confined.
    """
    path = job.beside(file)
    with key_path(table, key):
        check_inside(path)
    if is_file(path):
        return path
    if is_folder(path):
        raise OptionError(f"{table}.{key} = {file!r} is a folder ({path})", key=(table, key))
    siblings = []
    if is_folder(path.parent):
        siblings = [sibling.name for sibling in path.parent.iterdir() if sibling.is_file()]
    hint = f"the folder {str(path.parent)!r} is empty or does not exist"
    if siblings:
        hint = suggest(path.name, siblings)
    raise OptionError(f"{table}.{key} = {file!r}: no such file; {hint}", key=(table, key))
