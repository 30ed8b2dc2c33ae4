"""Matrix Market: a model as a small TOML file that lists its matrix files and its DOFs.

File names are relative to the TOML file, whose keys are in docs/formats.md. Matrices are real,
coordinate or array, symmetric or general. For matrix files of Abaqus see `updyn.io.abaqus.table`,
for OUTPUT4 and DMIG files of Nastran `updyn.io.nastran.matrices`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import scipy.sparse as sp

from updyn.errors import FormatError, ModelError, OptionError
from updyn.io.abaqus.matrices import is_abaqus
from updyn.io.abaqus.model import read_model as read_abaqus_model
from updyn.io.abaqus.table import names_abaqus_files
from updyn.io.abaqus.table import read_table as read_abaqus_table
from updyn.io.atomic import atomic_path
from updyn.io.damping import DAMPING, plain_damping
from updyn.io.items import locate_errors
from updyn.io.matrix_market_file import has_banner, read_matrix
from updyn.io.model_table import GENERAL, ModelFile, write_tables
from updyn.io.nastran.matrices import names_nastran_files
from updyn.io.nastran.matrices import read_table as read_nastran_table
from updyn.model import Group, Matrix, Model

__all__ = ["read_model", "write_model"]

_MATRICES = ("stiffness", "mass", "viscous")
_GROUP = ("name", *_MATRICES, *DAMPING)
_DIGITS = 17  # sufficient to recover any double exactly


def read_model(path: str | Path, *, unit: str = "m", internal: str = "keep") -> Model:
    """Read a model from its TOML file, or from a matrix file of Abaqus.

    `unit` and `internal` apply only to a matrix file of Abaqus; a TOML file states its own.
    """
    path = Path(path)
    if path.suffix.lower() == ".mtx" and is_abaqus(path):
        return read_abaqus_model(path, unit=unit, internal=internal)
    if (unit, internal) != ("m", "keep"):
        raise OptionError(
            f"{path}: unit and internal apply only to matrix files of Abaqus; a TOML file states"
            " them itself"
        )
    _refuse_matrix(path)
    table = ModelFile.read_file(path)
    if table.has_groups and names_nastran_files(table):
        return read_nastran_table(table)
    if table.has_groups and names_abaqus_files(table):
        return read_abaqus_table(table)
    return _model(table)


def _refuse_matrix(path: Path) -> None:
    """Refuse a file that is a matrix, not a TOML file."""
    with path.open("rb") as file:
        start = file.read(32)
    if has_banner(start):
        raise FormatError(
            "one matrix is not a model: write a small TOML file in the same folder and read it."
            ' Content: dofs = "dofs.csv" (header "dof", then one label per line such as 12:Z), and'
            f' for each part [[group]] with name = "...", stiffness = "{path.name}",'
            ' mass = "...", loss_factor = 0.01',
            path,
        )
    if path.suffix.lower() == ".mtx":
        raise FormatError(
            f"not a Matrix Market file: it starts with {start!r}, expected '%%MatrixMarket'", path
        )


def _model(table: ModelFile) -> Model:
    """Build the model of a TOML file that refers to Matrix Market files."""
    path, content = table.path, table.content
    table.check_keys(content, GENERAL)
    if "group" not in content:
        raise FormatError(
            f"no [[group]]; a model needs at least one, with {', '.join(_GROUP)}", path
        )
    if not table.has_groups:
        raise FormatError(
            "'group' is not a list of tables; write [[group]]", path, table.line("group")
        )
    dofs = table.dofs()
    if dofs is None:
        raise FormatError(
            'no \'dofs\': expected dofs = "dofs.csv" (a table) or dofs = ["1:X", "1:Y"] (the'
            " labels)",
            path,
        )
    groups: dict[str, Group] = {}
    for number, parts in enumerate(content["group"]):
        name, group = _group(table, parts, number, len(dofs))
        if name in groups:
            raise FormatError(
                f"group name {name!r} occurs twice", path, table.line("name", "group", number)
            )
        groups[name] = group
    geometry = table.geometry()
    title = table.title
    with locate_errors(path):
        return Model.from_groups(groups, dofs, geometry=geometry, title=title)


def _group(table: ModelFile, parts: Mapping[str, Any], number: int, n: int) -> tuple[str, Group]:
    table.check_keys(parts, _GROUP, "group", number)
    name = table.group_name(parts, number)
    matrices = {}
    for what in _MATRICES:
        if what in parts:
            file = table.file(parts, what, "group", number)
            matrices[what] = read_matrix(file, n)
    damping = {what: parts[what] for what in DAMPING if what in parts}
    try:
        return name, Group(**matrices, **damping)
    except ModelError as error:
        key = _find_key(str(error), matrices)
        named = f" ({parts[key]})" if key in matrices else ""
        raise FormatError(
            f"group {name!r}: {error}{named}", table.path, table.line(key, "group", number)
        ) from error


def _find_key(fault: str, matrices: Mapping[str, object]) -> str:
    """Return the key that an error of `Group` is about, identified by its first words."""
    for what in DAMPING:
        if fault.replace(" ", "_").startswith(what):
            return what
    for what in matrices:
        if fault.startswith(what):
            return what
    return "name"


# -- writing ------------------------------------------------------------------------------------
def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a TOML file with files of matrices and tables.

    Files of ``case.toml`` are named ``case_01_K.mtx``, ``case_dofs.csv`` and so on. The TOML file
    is written last.
    """
    import tomlkit

    path = Path(path)
    if path.suffix.lower() == ".mtx":
        raise FormatError(
            f"a model is more than one matrix; write to {path.with_suffix('.toml').name!r} instead",
            path,
        )
    entry = write_tables(model, path)
    listed = tomlkit.aot()
    for number, (name, group) in enumerate(model.groups.items(), 1):
        table = tomlkit.table()
        table["name"] = name
        for what, letter in zip(_MATRICES, "KMC", strict=True):
            matrix = getattr(group, what)
            if matrix is not None:
                table[what] = _file_name(path, f"{number:02d}_{letter}.mtx")
                with atomic_path(path.parent / table[what]) as temporary:
                    _write_matrix(matrix, temporary, name)
        table.update(plain_damping(group))
        listed.append(table)
    entry["group"] = listed
    with atomic_path(path) as temporary:
        temporary.write_text(tomlkit.dumps(entry), encoding="utf-8")


def _file_name(path: Path, end: str) -> str:
    return f"{path.stem}_{end}"


def _write_matrix(matrix: Matrix, path: Path, name: str) -> None:
    from scipy.io import mmwrite

    comment = f" group {name}".encode("ascii", "backslashreplace").decode("ascii")
    with path.open("wb") as file:
        mmwrite(
            file, sp.coo_array(matrix), comment=comment, precision=_DIGITS, symmetry="symmetric"
        )
