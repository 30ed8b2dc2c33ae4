"""Models of OUTPUT4 and DMIG matrices, through the TOML file of `updyn.io.matrix_market`.

::

    unit = "mm"                        # of all matrices: "m" where absent, "mm", "in"
    deck = "wing.bdf"                  # optional: where the grids stand; for OUTPUT4 the order of the DOFs
    dofs = "dofs.csv"                  # optional: the DOFs of the rows of OUTPUT4 matrices, a table or the labels

    [[group]]
    name = "skin"
    stiffness = "skin.op4:KGG"         # file and matrix; without a name the file holds one matrix
    mass = "skin.op4:MGG"
    loss_factor = 0.02                 # optional, 0 where absent; other damping as in `updyn.io.matrix_market`

    [[group]]
    name = "spar"
    stiffness = "spar.pch:KAAX"        # DMIG has its own labels

Without ``dofs``, the rows of OUTPUT4 matrices are all grids of the deck in ascending order, six DOFs each, and its
scalar points, one each: the g-set as Nastran writes it where it has not been resequenced.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError, ModelError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path
from updyn.io.consistent_units import system
from updyn.io.damping import DAMPING, plain_damping
from updyn.io.dof_table import write_dofs, write_geometry, write_lines
from updyn.io.guard import placed
from updyn.io.nastran.deck import Deck, read_deck
from updyn.io.nastran.dmig import DMIGMatrix, read_dmig, write_dmig
from updyn.io.nastran.geometry import geometry_of
from updyn.io.nastran.op4 import OP4Matrix, read_op4, select, write_op4
from updyn.model import Group, Model

if TYPE_CHECKING:
    from updyn.io.matrix_market import Entry

__all__ = ["SUFFIXES", "names_nastran_files", "read_beside", "read_table", "write_beside"]

#: Which reader takes which files.
SUFFIXES = {".op4": "op4", ".pch": "dmig", ".dmig": "dmig"}
_MATRICES = ("stiffness", "mass", "viscous")
_TOP = ("title", "dofs", "geometry", "group", "unit", "deck")
_GROUP = ("name", *_MATRICES, *DAMPING)


def names_nastran_files(table: Mapping[str, Any]) -> bool:
    """Say whether a group of the table names an OUTPUT4 or a DMIG file."""
    given = [
        g.get(what) for g in table.get("group", ()) if isinstance(g, dict) for what in _MATRICES
    ]
    return any(
        isinstance(text, str) and Path(_split(text)[0]).suffix.lower() in SUFFIXES for text in given
    )


def read_table(
    entry: Entry, table: Mapping[str, Any], dofs: DofSet | None, geometry: Geometry | None
) -> Model:
    """Build the model of a TOML file.

    Parameters
    ----------
    entry : Entry
        The file, for messages.
    table : mapping
        What it holds.
    dofs : DofSet, optional
        What its ``dofs`` say.
    geometry : Geometry, optional
        What its ``[geometry]`` says.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If a key is unknown, a file is missing or not valid, or sizes and labels do not fit each
        other.

    Warns
    -----
    UpdynWarning
        If DOFs have no entry in any matrix (rotations of solids, for instance): they are left out.
    """
    entry.only_known(table, _TOP, "")
    units = system(entry.text(table, "unit") if "unit" in table else "m")
    if "deck" in table:
        deck = read_deck(entry.file(table, "deck"), None)
        geometry = geometry_of(deck, units.name) if geometry is None else geometry
        dofs = _dofs_of(deck) if dofs is None else dofs
    files = _Files()
    named: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {}
    for number, parts in enumerate(table["group"]):
        entry.only_known(parts, _GROUP, "group", number)
        if "name" not in parts:
            raise FormatError(
                f"[[group]] number {number + 1} has no name",
                entry.path,
                entry.line("name", "group", number),
            )
        name = entry.text(parts, "name", "group", number)
        if name in named:
            raise FormatError(
                f"group name {name!r} stands twice", entry.path, entry.line("name", "group", number)
            )
        found = {w: files.matrix(entry, parts, w, number) for w in _MATRICES if w in parts}
        named[name] = found, {what: parts[what] for what in DAMPING if what in parts}
    dofs, used = _used(entry, [m for found, _ in named.values() for m in found.values()], dofs)
    groups = {}
    for number, (name, (found, damping)) in enumerate(named.items()):
        matrices = {}
        for what, matrix in found.items():
            whole = _placed(matrix, dofs, entry, entry.line(what, "group", number))
            matrices[what] = units.to_si(whole, dofs)[used][:, used]
        try:
            groups[name] = Group(**matrices, **damping)
        except ModelError as error:
            raise FormatError(
                f"group {name!r}: {error}", entry.path, entry.line("name", "group", number)
            ) from error
    title = entry.text(table, "title") if "title" in table else ""
    with placed(entry.path):
        return Model.from_groups(groups, dofs[used], geometry=geometry, title=title)


def _split(text: str) -> tuple[str, str | None]:
    """Split ``file:NAME``; the colon of a drive letter is none."""
    file, colon, name = text.rpartition(":")
    if not colon or "/" in name or "\\" in name or (len(file) == 1 and file.isalpha()):
        return text, None
    return file, name.strip()


class _Files:
    """The matrix files, each read once."""

    def __init__(self) -> None:
        self._op4: dict[Path, list[OP4Matrix]] = {}
        self._dmig: dict[Path, list[DMIGMatrix]] = {}

    def matrix(
        self, entry: Entry, parts: Mapping[str, Any], key: str, number: int
    ) -> OP4Matrix | DMIGMatrix:
        file, name = _split(entry.text(parts, key, "group", number))
        path = entry.file({key: file}, key, "group", number)
        kind = SUFFIXES.get(path.suffix.lower())
        if kind is None:
            raise FormatError(
                f"{key}: {file!r} beside OUTPUT4 or DMIG files; expected one of"
                f" {', '.join(SUFFIXES)}",
                entry.path,
                entry.line(key, "group", number),
            )
        if kind == "op4":
            if path not in self._op4:
                self._op4[path] = read_op4(path)
            return select(self._op4[path], name, path)
        if path not in self._dmig:
            self._dmig[path] = read_dmig(path)
        names = [m.name for m in self._dmig[path]]
        if name is None and len(names) == 1:
            return self._dmig[path][0]
        if name is None:
            raise FormatError(
                f"holds {len(names)} matrices ({', '.join(names)}); say which: FILE:NAME", path
            )
        if name.upper() not in names:
            raise FormatError(f"no matrix {name!r}; {suggest(name.upper(), names)}", path)
        return self._dmig[path][names.index(name.upper())]


def _dofs_of(deck: Deck) -> DofSet:
    nodes = np.array(sorted([*deck.grids, *deck.points]))
    many = np.where(np.isin(nodes, list(deck.points)), 1, 6)
    axes = np.concatenate([np.arange(n) for n in many])
    return DofSet.from_arrays(np.repeat(nodes, many), axes)


def _used(entry: Entry, matrices: list[Any], dofs: DofSet | None) -> tuple[DofSet, Any]:
    """Return all DOFs, and the positions of those that have an entry in some matrix."""
    if dofs is None:
        if not all(isinstance(m, DMIGMatrix) for m in matrices):
            raise FormatError(
                'OUTPUT4 matrices have no labels: say dofs = "dofs.csv" (a table), dofs = ["1:X",'
                ' ...], or deck = "wing.bdf" (all its grids in ascending order, six DOFs each)',
                entry.path,
            )
        keys = np.unique(np.concatenate([m.dofs.nodes * 6 + m.dofs.axes for m in matrices]))
        return DofSet.from_arrays(keys // 6, keys % 6), np.arange(len(keys))
    used = np.zeros(len(dofs), dtype=np.bool_)
    for m in matrices:
        if isinstance(m, DMIGMatrix):
            with placed(entry.path, f"DMIG {m.name}"):
                used[dofs.match(m.dofs).index] = True
        elif m.matrix.shape[0] == len(dofs):
            used[np.unique(sp.coo_array(m.matrix).row)] = True
    if not used.all() and used.any():
        first = dofs[int(np.flatnonzero(~used)[0])]
        warnings.warn(
            f"{entry.path}: {int((~used).sum())} of {len(dofs)} DOFs have no entry in any matrix"
            f" and are left out, the first of them {first}",
            UpdynWarning,
            stacklevel=4,
        )
    return dofs, np.flatnonzero(used)


def _placed(matrix: OP4Matrix | DMIGMatrix, dofs: DofSet, entry: Entry, line: int | None) -> Any:
    n = len(dofs)
    if isinstance(matrix, OP4Matrix):
        if matrix.matrix.shape != (n, n):
            rows, columns = matrix.matrix.shape
            raise FormatError(
                f"matrix {matrix.name} is {rows} x {columns}, but there are {n} DOFs",
                entry.path,
                line,
            )
        return sp.csr_array(matrix.matrix)
    at = dofs.match(matrix.dofs).index
    own = sp.coo_array(matrix.matrix)
    return sp.csr_array(sp.coo_array((own.data, (at[own.row], at[own.col])), shape=(n, n)))


def read_beside(path: str | Path) -> Model:
    """Read the model whose matrices are in an OUTPUT4 or DMIG file, from the TOML file of the same name beside it.

    Parameters
    ----------
    path : path
        The matrix file, or the TOML file itself.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If there is no such TOML file; the message says what it would hold.
    """
    from updyn.io.matrix_market import read_model

    path = Path(path)
    told = path.with_suffix(".toml")
    if told.is_file():
        return read_model(told)
    names = [
        m.name
        for m in (read_op4(path) if SUFFIXES.get(path.suffix.lower()) == "op4" else read_dmig(path))
    ]
    raise FormatError(
        f"matrices alone ({', '.join(names)}) are not a model: write {told.name!r} beside it and"
        " read that. It holds: "
        f'dofs = "dofs.csv" or deck = "wing.bdf", and for each part [[group]] with name = "...", '
        f'stiffness = "{path.name}:{names[0]}", mass = "...", loss_factor = 0.01',
        path,
    )


def write_beside(model: Model, path: str | Path, kind: str) -> None:
    """Write a model's matrices to one file, and a TOML file that says what they are.

    Parameters
    ----------
    model : Model
        The model.
    path : path
        The matrix file, or the TOML file; the other is named like it.
    kind : {"op4", "dmig"}
        Format of the matrices: binary OUTPUT4, or DMIG cards in large fields. The matrices are
        called K1, M1, C1, K2,
        ... by the number of the group.

    Raises
    ------
    FormatError
        If the format cannot hold the model.
    """
    import tomlkit

    path = Path(path)
    told = path.with_suffix(".toml")
    held = (
        path
        if path.suffix.lower() != ".toml"
        else path.with_suffix(".op4" if kind == "op4" else ".pch")
    )
    if SUFFIXES.get(held.suffix.lower()) != kind:
        wanted = " or ".join(s for s, k in SUFFIXES.items() if k == kind)
        raise FormatError(f"suffix {held.suffix!r}; expected {wanted}, or .toml", path)
    entry = tomlkit.document()
    if model.title:
        entry["title"] = model.title
    entry["dofs"] = f"{path.stem}_dofs.csv"
    with atomic_path(path.parent / entry["dofs"]) as temporary:
        write_dofs(model.dofs, temporary)
    if model.geometry is not None:
        entry["geometry"] = _write_geometry(model.geometry, path)
    listed, matrices = tomlkit.aot(), {}
    for number, (name, group) in enumerate(model.groups.items(), 1):
        table = tomlkit.table()
        table["name"] = name
        for what, letter in zip(_MATRICES, "KMC", strict=True):
            if (matrix := getattr(group, what)) is not None:
                matrices[f"{letter}{number}"] = matrix
                table[what] = f"{held.name}:{letter}{number}"
        table.update(plain_damping(group))
        listed.append(table)
    entry["group"] = listed
    if kind == "op4":
        write_op4(matrices, held)
    else:
        write_dmig(matrices, model.dofs, held)
    with atomic_path(told) as temporary:
        temporary.write_text(tomlkit.dumps(entry), encoding="utf-8")


def _write_geometry(geometry: Geometry, path: Path) -> Any:
    import tomlkit

    table = tomlkit.table()
    table["nodes"] = f"{path.stem}_nodes.csv"
    with atomic_path(path.parent / table["nodes"]) as temporary:
        write_geometry(geometry, temporary)
    if len(geometry.lines):
        table["lines"] = f"{path.stem}_lines.csv"
        with atomic_path(path.parent / table["lines"]) as temporary:
            write_lines(geometry, temporary)
    return table
