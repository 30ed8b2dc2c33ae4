"""The TOML file of a model whose matrices are in other files, with tables of DOFs and nodes.

It contains the common part of the readers of matrix files: the keys ``title``, ``dofs``,
``geometry`` and ``group``, with their lines.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from updyn.dofs import DofSet
from updyn.errors import FormatError, suggest
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.dof_table import (
    read_dofs,
    read_geometry,
    write_dofs,
    write_faces,
    write_geometry,
    write_lines,
)
from updyn.io.items import is_file, locate_errors, read_utf8, suggest_file
from updyn.io.toml_text import parse_toml
from updyn.model import Model

__all__ = ["GENERAL", "ModelFile", "write_tables"]

#: Keys of every such file.
GENERAL = ("title", "dofs", "geometry", "group")
_JOB = ("model", "test", "parameter")  # tables of a job file, the other kind of TOML file
_DRAWN_TABLES = ("lines", "faces")


class ModelFile:
    """A TOML file of a model: its content, and checks of its keys with their lines."""

    def __init__(self, path: Path, content: Mapping[str, Any], text: str) -> None:
        self.path = path
        self.content = content
        self._lines = text.splitlines()

    @classmethod
    def read_file(cls, path: Path) -> ModelFile:
        """Read the file; refuse files other than TOML in UTF-8, and job files."""
        text = read_utf8(path)
        try:
            content = parse_toml(text)
        except tomllib.TOMLDecodeError as error:
            line = re.search(r"at line (\d+)", str(error))
            raise FormatError(
                f"not a TOML file: {error}", path, int(line[1]) if line else None
            ) from error
        found = [name for name in _JOB if name in content]
        if "group" not in content and found:
            raise FormatError(
                f"looks like a job file (it has {found[0]!r}), not a model:"
                f" updyn check {path.name}",
                path,
            )
        return cls(path, content, text)

    @property
    def has_groups(self) -> bool:
        """Whether ``group`` is a list of tables."""
        groups = self.content.get("group")
        return isinstance(groups, list) and all(isinstance(g, dict) for g in groups)

    @property
    def title(self) -> str:
        """The title, or an empty text."""
        return self.optional("title", "")

    def optional(self, key: str, default: str) -> str:
        """Return a text of the top level, or the default."""
        return self.text(self.content, key) if key in self.content else default

    def dofs(self) -> DofSet | None:
        """Return the DOFs, from labels or from a table, or None."""
        given = self.content.get("dofs")
        if given is None:
            return None
        if isinstance(given, list):
            with locate_errors(self.path, "dofs"):
                return DofSet(given)
        return read_dofs(self.file(self.content, "dofs"))

    def geometry(self) -> Geometry | None:
        """Return the geometry, or None."""
        table = self.content.get("geometry")
        if table is None:
            return None
        if not isinstance(table, dict) or "nodes" not in table:
            raise FormatError(
                "[geometry] needs nodes = 'nodes.csv', and may have lines and faces",
                self.path,
                self.line("geometry"),
            )
        self.check_keys(table, ("nodes", *_DRAWN_TABLES), "geometry")
        drawn = [
            self.file(table, key, "geometry") if key in table else None for key in _DRAWN_TABLES
        ]
        return read_geometry(self.file(table, "nodes", "geometry"), *drawn)

    def group_name(self, parts: Mapping[str, object], number: int) -> str:
        """Return the name of group `number`, counted from 0; refuse a group without name."""
        if "name" not in parts:
            raise FormatError(
                f"[[group]] number {number + 1} has no name",
                self.path,
                self.line("name", "group", number),
            )
        return self.text(parts, "name", "group", number)

    def line(self, key: str, table: str = "", number: int = 0) -> int | None:
        """Return the line of a key in table `number` of that name, by default of its header."""
        count: dict[str, int] = {}
        current, header = "", None
        for at, line in enumerate(self._lines, 1):
            if found := re.match(r"\s*\[\[?\s*([\w.-]+)\s*\]", line):
                current = found[1]
                count[current] = count.get(current, -1) + 1
                if current in (table, key) and (current == key or count[current] == number):
                    header = at
            elif (
                current == table
                and count.get(table, 0) == number
                and re.match(rf'\s*"?{re.escape(key)}"?\s*=', line)
            ):
                return at
        return header

    def check_keys(
        self, table: Mapping[str, object], known: tuple[str, ...], name: str = "", number: int = 0
    ) -> None:
        """Refuse unknown keys of a table, with the nearest known one."""
        where = f" in [{name}]" if name else ""
        for key in table:
            if key not in known:
                raise FormatError(
                    f"unknown key {key!r}{where}; {suggest(key, known)}",
                    self.path,
                    self.line(key, name, number),
                )

    def text(self, table: Mapping[str, Any], key: str, name: str = "", number: int = 0) -> str:
        """Return the value of a key, which must be a text."""
        value = table[key]
        if not isinstance(value, str):
            raise FormatError(
                f"{key} is {value!r}; expected a text", self.path, self.line(key, name, number)
            )
        return value

    def file(self, table: Mapping[str, Any], key: str, name: str = "", number: int = 0) -> Path:
        """Return the path of a file, which must exist, from the value of a key."""
        given = self.text(table, key, name, number)
        found = self.path.parent / given
        if is_file(found):
            return found
        raise FormatError(
            f"{key}: no such file {given!r}; {suggest_file(found)}",
            self.path,
            self.line(key, name, number),
        )


def write_tables(model: Model, path: Path) -> Any:
    """Write the tables of DOFs, nodes, lines and faces, and return the start of the TOML file."""
    # The tables of ``case.toml`` are named ``case_dofs.csv``, ``case_nodes.csv`` and so on.
    import tomlkit

    entry = tomlkit.document()
    if model.title:
        entry["title"] = model.title
    dofs = path.with_name(f"{path.stem}_dofs.csv")
    entry["dofs"] = dofs.name
    with atomic_path(dofs) as temporary:
        write_dofs(model.dofs, temporary)
    geometry = model.geometry
    if geometry is None:
        return entry
    table = tomlkit.table()
    nodes = path.with_name(f"{path.stem}_nodes.csv")
    table["nodes"] = nodes.name
    with atomic_path(nodes) as temporary:
        write_geometry(geometry, temporary)
    for key, write in zip(_DRAWN_TABLES, (write_lines, write_faces), strict=True):
        if len(getattr(geometry, key)):
            drawn = path.with_name(f"{path.stem}_{key}.csv")
            table[key] = drawn.name
            with atomic_path(drawn) as temporary:
                write(geometry, temporary)
    entry["geometry"] = table
    return entry
