"""Models of OUTPUT4, OUTPUT2 and DMIG matrices, defined by a TOML file.

The additional keys of the file are ``unit``, ``deck`` and ``dofs``; a matrix is ``"skin.op4:KGG"``,
file and name. Without ``dofs``, the rows of OUTPUT4 matrices are the g-set without resequencing:
six DOFs for each grid of the deck, one for each scalar point, ascending. In an OUTPUT2 file the
table EQEXIN defines the order.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import AbsentError, FormatError, ModelError, UpdynWarning
from updyn.io.atomic import atomic_path
from updyn.io.consistent_units import find_units
from updyn.io.damping import DAMPING, plain_damping
from updyn.io.items import locate_errors
from updyn.io.model_table import GENERAL, ModelFile, write_tables
from updyn.io.nastran.deck import NastranDeck, build_geometry, read_deck
from updyn.io.nastran.dmig import DMIGMatrix, read_dmig, write_dmig
from updyn.io.nastran.op2_file import OP2File, g_set, read_matrix, refuse_element_blocks
from updyn.io.nastran.op4 import OP4Matrix, read_op4, select, write_op4
from updyn.model import Group, Model

__all__ = ["DMIG", "OP2", "OP4", "SUFFIXES", "MatrixFiles", "names_nastran_files", "read_table"]

#: Reader by file suffix.
SUFFIXES = {".op4": "op4", ".op2": "op2", ".pch": "dmig", ".dmig": "dmig"}
#: Suffix of the matrix file if the path names the TOML file.
_WRITTEN = {"op4": ".op4", "dmig": ".pch"}
_MATRICES = ("stiffness", "mass", "viscous")
_TOP = (*GENERAL, "unit", "deck")
_GROUP = ("name", *_MATRICES, *DAMPING)
_NastranMatrix = OP4Matrix | DMIGMatrix


def names_nastran_files(table: ModelFile) -> bool:
    """Return whether a group of the table refers to an OUTPUT4, an OUTPUT2 or a DMIG file."""
    for group in table.content["group"]:
        for what in _MATRICES:
            given = group.get(what)
            if isinstance(given, str) and Path(_split(given)[0]).suffix.lower() in SUFFIXES:
                return True
    return False


def read_table(table: ModelFile) -> Model:
    """Build the model of a TOML file, without DOFs that have no entries in any matrix."""
    content = table.content
    dofs, geometry = table.dofs(), table.geometry()
    table.check_keys(content, _TOP)
    units = find_units(table.optional("unit", "m"))
    if "deck" in content:
        deck = read_deck(table.file(content, "deck"), None)
        if geometry is None:
            geometry = build_geometry(deck, units.name)
        if dofs is None:
            dofs = _matrix_dofs(deck)
    files = _MatrixFiles(table)
    named: dict[str, dict[str, _NastranMatrix]] = {}
    for number, parts in enumerate(content["group"]):
        table.check_keys(parts, _GROUP, "group", number)
        name = table.group_name(parts, number)
        if name in named:
            raise FormatError(
                f"group name {name!r} occurs twice", table.path, table.line("name", "group", number)
            )
        named[name] = {}
        for what in _MATRICES:
            if what in parts:
                named[name][what] = files.matrix(parts, what, number)
    if dofs is None:
        dofs = files.g_set()
    dofs, used = _used_dofs(table, list(chain(*(found.values() for found in named.values()))), dofs)
    groups = {}
    for number, (name, found) in enumerate(named.items()):
        parts = content["group"][number]
        entries = {what: parts[what] for what in DAMPING if what in parts}
        for what, matrix in found.items():
            whole = _expand_to_dofs(matrix, dofs, table, table.line(what, "group", number))
            entries[what] = units.to_si(whole, dofs)[used][:, used]
        try:
            groups[name] = Group(**entries)
        except ModelError as error:
            raise FormatError(
                f"group {name!r}: {error}", table.path, table.line("name", "group", number)
            ) from error
    title = table.title
    with locate_errors(table.path):
        return Model.from_groups(groups, dofs[used], geometry=geometry, title=title)


def _split(text: str) -> tuple[str, str | None]:
    """Split ``file:NAME``; the colon after a drive letter does not separate."""
    file, colon, name = text.rpartition(":")
    if not colon or "/" in name or "\\" in name or (len(file) == 1 and file.isalpha()):
        return text, None
    return file, name.strip()


class _MatrixFiles:
    """The matrix files that a TOML file refers to, each read once."""

    def __init__(self, table: ModelFile) -> None:
        self._table = table
        self._read: dict[Path, Sequence[_NastranMatrix]] = {}
        self._op2: dict[Path, OP2File] = {}

    def matrix(self, parts: Mapping[str, Any], key: str, number: int) -> _NastranMatrix:
        table = self._table
        file, name = _split(table.text(parts, key, "group", number))
        path = table.file({key: file}, key, "group", number)
        kind = SUFFIXES.get(path.suffix.lower())
        if kind is None:
            raise FormatError(
                f"{key}: {file!r} mixed with OUTPUT4, OUTPUT2 or DMIG files; expected one of"
                f" {', '.join(SUFFIXES)}",
                table.path,
                table.line(key, "group", number),
            )
        if kind == "op2":
            if path not in self._op2:
                self._op2[path] = OP2File(path)
            op2 = self._op2[path]
            refuse_element_blocks(op2, [name or ""])
            return read_matrix(op2, select(op2.matrices, name, path))
        if path not in self._read:
            self._read[path] = read_op4(path) if kind == "op4" else read_dmig(path)
        return select(self._read[path], name, path)

    def g_set(self) -> DofSet | None:
        """Return the degrees of freedom that an OUTPUT2 file defines, or None."""
        for file in self._op2.values():
            dofs = g_set(file)
            if dofs is not None:
                return dofs
        return None


def _matrix_dofs(deck: NastranDeck) -> DofSet:
    nodes = np.array(sorted([*deck.grids, *deck.points]))
    axes = np.tile(np.arange(6), (len(nodes), 1))
    is_point = np.isin(nodes, list(deck.points))
    exists = (axes == 0) | ~is_point[:, None]
    return DofSet.from_arrays(np.repeat(nodes, exists.sum(axis=1)), axes[exists])


def _used_dofs(
    table: ModelFile, matrices: list[_NastranMatrix], dofs: DofSet | None
) -> tuple[DofSet, Any]:
    """Return all DOFs, and the positions of those with entries in some matrix."""
    if dofs is None:
        labelled = []
        for m in matrices:
            if not isinstance(m, DMIGMatrix):
                raise FormatError(
                    'OUTPUT4 matrices have no labels: add dofs = "dofs.csv" (a table), dofs ='
                    ' ["1:X", ...], or deck = "wing.bdf" (all its grids in ascending order, six'
                    " DOFs each)",
                    table.path,
                )
            labelled.append(m.dofs.nodes * 6 + m.dofs.axes)
        keys = np.unique(np.concatenate(labelled))
        return DofSet.from_arrays(keys // 6, keys % 6), np.arange(len(keys))
    used = np.zeros(len(dofs), dtype=np.bool_)
    for m in matrices:
        if isinstance(m, DMIGMatrix):
            with locate_errors(table.path, f"DMIG {m.name}"):
                used[dofs.match(m.dofs).index] = True
        elif m.matrix.shape[0] == len(dofs):
            used[np.unique(sp.coo_array(m.matrix).row)] = True
    if not used.all() and used.any():
        first = dofs[int(np.flatnonzero(~used)[0])]
        warnings.warn(
            f"{table.path}: {int((~used).sum())} of {len(dofs)} DOFs have no entry in any matrix"
            f" and are removed; the first is {first}",
            UpdynWarning,
            stacklevel=4,
        )
    return dofs, np.flatnonzero(used)


def _expand_to_dofs(
    matrix: _NastranMatrix, dofs: DofSet, table: ModelFile, line: int | None
) -> Any:
    n = len(dofs)
    if isinstance(matrix, OP4Matrix):
        if matrix.matrix.shape != (n, n):
            rows, columns = matrix.matrix.shape
            raise FormatError(
                f"matrix {matrix.name} is {rows} x {columns}, but there are {n} DOFs",
                table.path,
                line,
            )
        return sp.csr_array(matrix.matrix)
    at = dofs.match(matrix.dofs).index
    entries = sp.coo_array(matrix.matrix)
    return sp.csr_array(
        sp.coo_array((entries.data, (at[entries.row], at[entries.col])), shape=(n, n))
    )


class MatrixFiles:
    """Models of the matrices in one OUTPUT4, OUTPUT2 or DMIG file and a TOML file of its name."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def read_model(self, path: str | Path) -> Model:
        """Read the model of a matrix file, defined by the TOML file of the same name.

        An `AbsentError` is raised for an OUTPUT2 file without it, which may hold other content.
        """
        path = Path(path)
        table_path = path.with_suffix(".toml")
        if table_path.is_file():
            table = ModelFile.read_file(table_path)
            if table.has_groups and names_nastran_files(table):
                return read_table(table)
            raise FormatError(
                f"no group refers to an OUTPUT4, OUTPUT2 or DMIG matrix ({', '.join(SUFFIXES)})",
                table_path,
            )
        kind: type[FormatError] = FormatError
        if self._kind == "op2":
            file = OP2File(path)
            names = [block.name for block in file.matrices]
            if not names:
                refuse_element_blocks(file, file.element_blocks)
            kind = AbsentError
        elif SUFFIXES.get(path.suffix.lower()) == "op4":
            names = [m.name for m in read_op4(path)]
        else:
            names = [m.name for m in read_dmig(path)]
        if not names:
            raise kind(
                "holds no matrices (KGG, MGG, ...): let Nastran write them to an OUTPUT4 file or as"
                " DMIG cards (PARAM,EXTOUT,DMIGPCH), or read the deck (.bdf)",
                path,
            )
        raise kind(
            f"matrices alone ({', '.join(names)}) are not a model: write {table_path.name!r} in the"
            ' same folder and read it. Content: dofs = "dofs.csv" or deck = "wing.bdf", and for'
            f' each part [[group]] with name = "...", stiffness = "{path.name}:{names[0]}",'
            ' mass = "...", loss_factor = 0.01',
            path,
        )

    def write_model(self, model: Model, path: str | Path) -> None:
        """Write a matrix file (K1, M1, C1, K2, ...) and the TOML file of the same name."""
        import tomlkit

        path = held = Path(path)
        if path.suffix.lower() == ".toml":
            held = path.with_suffix(_WRITTEN[self._kind])
        if SUFFIXES.get(held.suffix.lower()) != self._kind:
            wanted = " or ".join(s for s, kind in SUFFIXES.items() if kind == self._kind)
            raise FormatError(f"suffix {held.suffix!r}; expected {wanted}, or .toml", path)
        entry = write_tables(model, path)
        listed, matrices = tomlkit.aot(), {}
        for number, (name, group) in enumerate(model.groups.items(), 1):
            table = tomlkit.table()
            table["name"] = name
            for what, letter in zip(_MATRICES, "KMC", strict=True):
                matrix = getattr(group, what)
                if matrix is not None:
                    matrices[f"{letter}{number}"] = matrix
                    table[what] = f"{held.name}:{letter}{number}"
            table.update(plain_damping(group))
            listed.append(table)
        entry["group"] = listed
        if self._kind == "op4":
            write_op4(matrices, held)
        else:
            write_dmig(matrices, model.dofs, held)
        with atomic_path(path.with_suffix(".toml")) as temporary:
            temporary.write_text(tomlkit.dumps(entry), encoding="utf-8")


OP2 = MatrixFiles("op2")
OP4 = MatrixFiles("op4")
DMIG = MatrixFiles("dmig")
