"""Matrix Market: a model as a small TOML file that names its matrices, one ``.mtx`` a matrix, and its DOFs.

::

    title = "Gear case"
    dofs = "dofs.csv"                 # a table, see updyn.io.dof_table; or the labels: ["1:X", "1:Y"]

    [geometry]                        # optional
    nodes = "nodes.csv"
    lines = "lines.csv"               # optional

    [[group]]
    name = "housing"
    stiffness = "K_housing.mtx"       # stiffness, mass, viscous: at least one
    mass = "M_housing.mtx"
    loss_factor = 0.02                # optional, 0 where absent
    mass_damping = 1.5                # optional: C = 1.5 M, in 1/s
    stiffness_damping = 2e-5          # optional: C = 2e-5 K, in s
    loss_table = [[10, 200], [1, 3]]  # optional: lines in Hz, factors on loss_factor

File names are relative to the TOML file. Matrices are real, coordinate or array, symmetric or general. Where they are
those that Abaqus writes, the file reads as in `updyn.io.abaqus_toml`; OUTPUT4 and DMIG files of Nastran, as in
`updyn.io.nastran.matrices`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError, ModelError, OptionError, suggest
from updyn.geometry import Geometry
from updyn.io import abaqus_toml
from updyn.io.abaqus_matrix import is_abaqus
from updyn.io.atomic import atomic_path
from updyn.io.damping import DAMPING, plain_damping
from updyn.io.dof_table import read_dofs, read_geometry, write_dofs, write_geometry, write_lines
from updyn.io.guard import library, placed
from updyn.io.nastran import matrices as nastran_matrices
from updyn.model import Group, Matrix, Model

__all__ = ["read_model", "write_model"]

_TOP = ("title", "dofs", "geometry", "group")
_JOB = ("model", "test", "parameter")  # tables of a job file, the other kind of TOML file
_GEOMETRY = ("nodes", "lines")
_MATRICES = ("stiffness", "mass", "viscous")
_GROUP = ("name", *_MATRICES, *DAMPING)
_DIGITS = 17  # enough for any double to come back as it was


def read_model(path: str | Path, *, unit: str = "m", internal: str = "keep") -> Model:
    """Read a model from its TOML file. Matrix files of Abaqus, told by their content, are read by `updyn.io.abaqus`.

    Parameters
    ----------
    path : path
        The TOML file; or a matrix file as Abaqus names it, ``job_STIF1.mtx``.
    unit, internal : str
        As `updyn.io.abaqus.read_model`, of a matrix file of Abaqus; a TOML file says its own.

    Returns
    -------
    Model
        The model.

    Raises
    ------
    FormatError
        If a key is unknown, a file is missing, or a matrix or a table is not valid; the message
        says file and line.
    OptionError
        If an option has no place.
    """
    path = Path(path)
    if path.suffix.lower() == ".mtx" and is_abaqus(path):
        from updyn.io import abaqus

        return abaqus.read_model(path, unit=unit, internal=internal)
    if (unit, internal) != ("m", "keep"):
        raise OptionError(
            f"{path}: unit and internal are of matrix files of Abaqus; a TOML file says its own"
        )
    text = _source(path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"at line (\d+)", str(error))
        raise FormatError(
            f"not a TOML file: {error}", path, int(line[1]) if line else None
        ) from error
    if "group" not in table and (found := [name for name in _JOB if name in table]):
        raise FormatError(
            f"looks like a job file (it has {found[0]!r}), not a model: updyn check {path.name}",
            path,
        )
    entry = Entry(path, text)
    groups_are_tables = isinstance(table.get("group"), list)
    if groups_are_tables and nastran_matrices.names_nastran_files(table):
        return nastran_matrices.read_table(
            entry,
            table,
            _dofs(entry, table) if "dofs" in table else None,
            _geometry(entry, table["geometry"]) if "geometry" in table else None,
        )
    if groups_are_tables and abaqus_toml.names_abaqus_files(table, path.parent):
        return abaqus_toml.read_table(
            entry,
            table,
            _dofs(entry, table) if "dofs" in table else None,
            _geometry(entry, table["geometry"]) if "geometry" in table else None,
        )
    entry.only_known(table, _TOP, "")
    if "group" not in table:
        raise FormatError(
            f"no [[group]]; a model needs at least one, with {', '.join(_GROUP)}", path
        )
    if not isinstance(table["group"], list) or not all(isinstance(g, dict) for g in table["group"]):
        raise FormatError(
            "'group' is not a list of tables; write [[group]]", path, entry.line("group")
        )
    dofs = _dofs(entry, table)
    groups: dict[str, Group] = {}
    for number, parts in enumerate(table["group"]):
        name, group = _group(entry, parts, number)
        if name in groups:
            raise FormatError(
                f"group name {name!r} stands twice", path, entry.line("name", "group", number)
            )
        groups[name] = group
    geometry = _geometry(entry, table["geometry"]) if "geometry" in table else None
    title = entry.text(table, "title") if "title" in table else ""
    with placed(path):
        return Model.from_groups(groups, dofs, geometry=geometry, title=title)


def _source(path: Path) -> str:
    with path.open("rb") as file:
        raw = file.read()
    if raw.startswith(b"%%MatrixMarket"):
        raise FormatError(
            "one matrix alone is not a model: write a small TOML file beside it and read that. It"
            " holds: "
            'dofs = "dofs.csv" (header "dof", then one label a line such as 12:Z), and for each'
            " part [[group]] with "
            f'name = "...", stiffness = "{path.name}", mass = "...", loss_factor = 0.01',
            path,
        )
    if path.suffix.lower() == ".mtx":
        raise FormatError(
            f"not a Matrix Market file: it starts with {raw[:16]!r}, expected '%%MatrixMarket'",
            path,
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"not a text in UTF-8 ({error.reason} at byte {error.start})", path
        ) from error


class Entry:
    """The TOML file: checks of its keys, with the lines on which they stand."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._lines = text.splitlines()

    def line(self, key: str, table: str = "", number: int = 0) -> int | None:
        """Return the line of a key: in the `number`-th table of that name, else of its header."""
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

    def only_known(
        self, table: Mapping[str, Any], known: tuple[str, ...], name: str, number: int = 0
    ) -> None:
        """Refuse keys that mean nothing here; the nearest known one is named."""
        for key in table:
            if key not in known:
                where = f" in [{name}]" if name else ""
                raise FormatError(
                    f"unknown key {key!r}{where}; {suggest(key, known)}",
                    self.path,
                    self.line(key, name, number),
                )

    def text(self, table: Mapping[str, Any], key: str, name: str = "", number: int = 0) -> str:
        """Return the value of a key, which has to be a text."""
        value = table[key]
        if not isinstance(value, str):
            raise FormatError(
                f"{key} is {value!r}; expected a text", self.path, self.line(key, name, number)
            )
        return value

    def file(self, table: Mapping[str, Any], key: str, name: str = "", number: int = 0) -> Path:
        """Return the path of a file that the entry names, after checking that it is there."""
        given = self.text(table, key, name, number)
        found = self.path.parent / given
        if not found.is_file():
            folder = found.parent
            near = (
                sorted(p.name for p in folder.iterdir() if p.is_file()) if folder.is_dir() else []
            )
            state = (
                f"; {suggest(found.name, near)}"
                if near
                else ": its folder does not exist or is empty"
            )
            raise FormatError(
                f"{key}: no such file {given!r}{state}", self.path, self.line(key, name, number)
            )
        return found


def _dofs(entry: Entry, table: Mapping[str, Any]) -> DofSet:
    if "dofs" not in table:
        raise FormatError(
            'no \'dofs\': expected dofs = "dofs.csv" (a table) or dofs = ["1:X", "1:Y"] (the'
            " labels)",
            entry.path,
        )
    if isinstance(table["dofs"], list):
        with placed(entry.path, "dofs"):
            return DofSet(table["dofs"])
    return read_dofs(entry.file(table, "dofs"))


def _geometry(entry: Entry, table: Any) -> Geometry:
    if not isinstance(table, dict) or "nodes" not in table:
        raise FormatError(
            "[geometry] needs nodes = 'nodes.csv', and may have lines",
            entry.path,
            entry.line("geometry"),
        )
    entry.only_known(table, _GEOMETRY, "geometry")
    lines = entry.file(table, "lines", "geometry") if "lines" in table else None
    return read_geometry(entry.file(table, "nodes", "geometry"), lines)


def _group(entry: Entry, parts: Mapping[str, Any], number: int) -> tuple[str, Group]:
    entry.only_known(parts, _GROUP, "group", number)
    if "name" not in parts:
        raise FormatError(
            f"[[group]] number {number + 1} has no name",
            entry.path,
            entry.line("name", "group", number),
        )
    name = entry.text(parts, "name", "group", number)
    matrices = {
        what: _matrix(entry.file(parts, what, "group", number))
        for what in _MATRICES
        if what in parts
    }
    try:
        group = Group(**matrices, **{what: parts[what] for what in DAMPING if what in parts})
    except ModelError as error:
        fault = str(error)
        damping = next((what for what in DAMPING if fault.replace(" ", "_").startswith(what)), None)
        guilty = next(
            (what for what in _MATRICES if what in parts and fault.startswith(what)), None
        )
        guilty = None if damping else guilty
        key = guilty or damping or "name"
        file = f" ({parts[guilty]})" if guilty else ""
        raise FormatError(
            f"group {name!r}: {fault}{file}", entry.path, entry.line(key, "group", number)
        ) from error
    return name, group


def _matrix(path: Path) -> Matrix:
    from scipy.io import mminfo, mmread

    with library(path, "Matrix Market file"):
        rows, columns, _, _, field, symmetry = mminfo(path)
        if field not in ("real", "integer", "double", "unsigned-integer"):
            why = {
                "complex": "damping goes into loss_factor and viscous",
                "pattern": "a pattern says where entries stand, not what they are",
            }
            raise FormatError(
                f"field {field!r}: expected real; {why.get(field, 'numbers are needed')}", path, 1
            )
        if symmetry not in ("symmetric", "general"):
            raise FormatError(f"symmetry {symmetry!r}: expected symmetric or general", path, 1)
        if rows != columns:
            raise FormatError(f"the matrix is {rows} x {columns}; expected a square one", path)
        matrix = sp.coo_array(mmread(path))
    order = np.sort(matrix.row.astype(np.int64) * columns + matrix.col)
    twice = np.flatnonzero(np.diff(order) == 0)
    if twice.size:
        i, j = divmod(int(order[twice[0]]), columns)
        both = (
            "; under the header 'symmetric' only one triangle is stored"
            if symmetry == "symmetric"
            else ""
        )
        raise FormatError(f"entry ({i + 1}, {j + 1}) stands twice{both}", path)
    return matrix.tocsr()


# -- writing -----------------------------------------------------------------------------------------------
def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a TOML file, and its matrices and tables beside it.

    Parameters
    ----------
    model : Model
        The model.
    path : path
        The TOML file to write, for instance ``case.toml``; the others are called ``case_01_K.mtx``,
        ``case_dofs.csv`` and so on, and are replaced where they exist. The TOML file is written
        last.

    Raises
    ------
    FormatError
        If the suffix is ``.mtx``: a model is more than one matrix.
    """
    import tomlkit

    path = Path(path)
    if path.suffix.lower() == ".mtx":
        raise FormatError(
            f"a model is more than one matrix; write to {path.with_suffix('.toml').name!r} instead",
            path,
        )
    entry = tomlkit.document()
    if model.title:
        entry["title"] = model.title
    entry["dofs"] = _beside(path, "dofs.csv")
    with atomic_path(path.parent / entry["dofs"]) as temporary:
        write_dofs(model.dofs, temporary)
    if model.geometry is not None:
        entry["geometry"] = _write_geometry(model.geometry, path)
    listed = tomlkit.aot()
    for number, (name, group) in enumerate(model.groups.items(), 1):
        table = tomlkit.table()
        table["name"] = name
        for what, letter in zip(_MATRICES, "KMC", strict=True):
            matrix = getattr(group, what)
            if matrix is not None:
                table[what] = _beside(path, f"{number:02d}_{letter}.mtx")
                with atomic_path(path.parent / table[what]) as temporary:
                    _write_matrix(matrix, temporary, name)
        table.update(plain_damping(group))
        listed.append(table)
    entry["group"] = listed
    with atomic_path(path) as temporary:
        temporary.write_text(tomlkit.dumps(entry), encoding="utf-8")


def _beside(path: Path, end: str) -> str:
    return f"{path.stem}_{end}"


def _write_geometry(geometry: Geometry, path: Path) -> Any:
    import tomlkit

    table = tomlkit.table()
    table["nodes"] = _beside(path, "nodes.csv")
    with atomic_path(path.parent / table["nodes"]) as temporary:
        write_geometry(geometry, temporary)
    if len(geometry.lines):
        table["lines"] = _beside(path, "lines.csv")
        with atomic_path(path.parent / table["lines"]) as temporary:
            write_lines(geometry, temporary)
    return table


def _write_matrix(matrix: Matrix, path: Path, name: str) -> None:
    from scipy.io import mmwrite

    comment = f" group {name}".encode("ascii", "backslashreplace").decode("ascii")
    with path.open("wb") as file:
        mmwrite(
            file, sp.coo_array(matrix), comment=comment, precision=_DIGITS, symmetry="symmetric"
        )
