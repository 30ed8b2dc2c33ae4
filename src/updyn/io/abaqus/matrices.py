"""Matrix files of Abaqus (``*MATRIX OUTPUT``): rows of labels with one entry each.

Columns: node, dof, node, dof, a; or element, then these (ELEMENT BY ELEMENT); or row, column, a
(COORDINATE). Nodes below 0 are internal nodes of Abaqus; a diagonal entry of 1e36 marks a fixed
degree of freedom. Sources: Abaqus Keywords Guide, ``*MATRIX INPUT``; Abaqus Analysis User's Guide,
"Generating matrices"; 1e36 and the complete matrix for COORDINATE: descriptions of files by users.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import BoolArray, IndexArray, IntArray, RealArray
from updyn.dofs import DIRECTIONS, DofSet
from updyn.errors import FormatError, OptionError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.grouping import GroupOrigin
from updyn.io.consistent_units import UnitSystem
from updyn.io.items import locate_errors, unreadable_error
from updyn.io.keyword_deck.sets import distinct
from updyn.io.settings import MATRIX_FILE
from updyn.io.text_numbers import parse_real, parse_rows
from updyn.model import Group, Matrix, Model

__all__ = [
    "FIXED_DIAGONAL",
    "MATRICES",
    "NAME",
    "AbaqusEntries",
    "AbaqusGroup",
    "Labels",
    "assemble",
    "coordinate_matrix",
    "is_abaqus",
    "parse_entries",
    "read_entries",
]

#: Threshold below 1e36, the diagonal entry of a fixed degree of freedom.
FIXED_DIAGONAL = 1e35
#: Name of a matrix file of Abaqus: job, quantity, step.
NAME = re.compile(r"(.+)_(STIF|MASS|DMPV|DMPS)(\d+)", re.IGNORECASE)
_SHAPES = {
    3: "row, column, entry",
    5: "node, dof, node, dof, entry",
    6: "element, node, dof, node, dof, entry",
}
_OTHER_DOFS = {"7": "warping", "8": "pressure", "9": "electric potential"}


@dataclass(frozen=True, slots=True, eq=False)
class AbaqusEntries:
    """The rows of a matrix file.

    `labels` are node and dof (1 to 6) of row and of column, shape (n, 4), or row and column from 1,
    shape (n, 2). `elements`, shape (n,), is None for the matrix of the whole model.
    """

    path: Path
    labels: IntArray
    values: RealArray
    elements: IntArray | None = None

    @property
    def has_labels(self) -> bool:
        """Whether the rows contain node labels."""
        return int(self.labels.shape[1]) == 4

    def of(self, elements: IntArray) -> AbaqusEntries:
        """Return the rows of some elements."""
        assert self.elements is not None
        chosen = np.isin(self.elements, elements)
        return AbaqusEntries(
            self.path, self.labels[chosen], self.values[chosen], self.elements[chosen]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """The degrees of freedom of several matrix files, by node and direction, internal nodes last.

    `keys` has the node number in Abaqus and the dof 1 to 6, shape (N, 2).
    """

    keys: IntArray

    @classmethod
    def union(cls, files: Sequence[AbaqusEntries]) -> Labels:
        """Return the labels in the rows of all files."""
        pairs = np.unique(np.concatenate([f.labels.reshape(-1, 2) for f in files]), axis=0)
        internal = pairs[:, 0] < 0
        return cls(np.concatenate([pairs[~internal], pairs[internal][::-1]]))

    @property
    def internal(self) -> BoolArray:
        """Whether each is at an internal node, shape (N,)."""
        return np.asarray(self.keys[:, 0] < 0)

    @property
    def dofs(self) -> DofSet:
        """The N degrees of freedom; internal node -n becomes node (largest of the others) + n."""
        nodes = self.keys[:, 0]
        largest = int(nodes.max(initial=0))
        return DofSet.from_arrays(np.where(nodes < 0, largest - nodes, nodes), self.keys[:, 1] - 1)

    def matrix(self, file: AbaqusEntries) -> Matrix:
        """Return the entries of a file as a symmetric matrix, in the order of the labels."""
        codes = self.keys @ _CODE
        order = np.argsort(codes)
        at = order[np.searchsorted(codes[order], file.labels.reshape(-1, 2) @ _CODE)].reshape(-1, 2)
        return _symmetric(at[:, 0], at[:, 1], file, len(self.keys), self.dofs)


_CODE = np.array([8, 1])  # combines node and dof in one number


def is_abaqus(path: Path) -> bool:
    """Return whether a file is an Abaqus matrix, by its first row, for coordinates by its name."""
    fields: list[str] = []
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            for line in file:
                if _is_row(line):
                    fields = _fields(line)
                    break
    except OSError:
        return False
    if len(fields) not in _SHAPES or not _is_number(fields[-1]):
        return False
    return len(fields) > 3 or NAME.fullmatch(path.stem) is not None


def _is_row(line: str) -> bool:
    """Return whether a line is not empty, a comment or a keyword."""
    return bool(line.strip()) and not line.lstrip().startswith("*")


def _fields(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _is_number(text: str) -> bool:
    try:
        parse_real(text)
    except ValueError:
        return False
    return True


def read_entries(path: Path) -> AbaqusEntries:
    """Read a matrix file."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable_error(path, error) from error
    return parse_entries(raw, path)


def parse_entries(raw: bytes, path: Path, first_line: int = 1) -> AbaqusEntries:
    """Read the rows of a matrix; `first_line` is the line of the first row in the file."""
    first = list(islice(_rows(raw, first_line), MATRIX_FILE.sampled_rows))
    if not first:
        raise FormatError("the matrix file has no entry", path)
    columns = Counter(len(_fields(row)) for _, row in first).most_common(1)[0][0]
    if columns not in _SHAPES:
        line, row = first[0]
        expected = "; or ".join(_SHAPES.values())
        raise FormatError(f"found {row.strip()[:60]!r}; expected {expected}", path, line)
    letters = "i" * (columns - 1) + "r"
    table = parse_rows(raw, letters, _SHAPES[columns], path, first_line, commas=True, comment=b"*")
    labels = table[:, :-1].astype(np.int64)
    row_labels = labels[:, -4:]
    if columns > 3:
        nodes = row_labels[:, [0, 2]]
        directions = row_labels[:, [1, 3]]
        wrong = ((directions < 1) | (directions > 6)).any(axis=1) | (nodes == 0).any(axis=1)
    else:
        wrong = (row_labels < 1).any(axis=1)
    if wrong.any():
        raise _bad_label(raw, int(np.flatnonzero(wrong)[0]), path, first_line)
    elements = labels[:, 0] if columns == 6 else None
    return AbaqusEntries(path, row_labels, table[:, -1], elements)


def _rows(raw: bytes, first_line: int) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(raw.split(b"\n"), first_line):
        text = line.decode("ascii", "backslashreplace")
        if _is_row(text):
            yield number, text


def _bad_label(raw: bytes, at: int, path: Path, first_line: int) -> FormatError:
    line, row = next(islice(_rows(raw, first_line), at, None))
    fields = _fields(row)
    if len(fields) > 3 and int(fields[-2]) > 6:
        what = _OTHER_DOFS.get(fields[-2], "not of a structure")
        return FormatError(
            f"found {row.strip()!r}: degree of freedom {fields[-2]} ({what}); expected 1 to 6 for"
            f" {', '.join(DIRECTIONS)}",
            path,
            line,
        )
    return FormatError(
        f"found {row.strip()!r}; expected {_SHAPES[len(fields)]}, finite and counted from 1",
        path,
        line,
    )


def coordinate_matrix(file: AbaqusEntries, dofs: DofSet) -> Matrix:
    """Return a file of rows and columns as a symmetric matrix, in the order of `dofs`."""
    largest = int(file.labels.max())
    if largest > len(dofs):
        raise FormatError(
            f"an entry is in row or column {largest}; there are {len(dofs)} labels", file.path
        )
    return _symmetric(file.labels[:, 0] - 1, file.labels[:, 1] - 1, file, len(dofs), dofs)


def _symmetric(
    row: IntArray, column: IntArray, file: AbaqusEntries, n: int, dofs: DofSet
) -> Matrix:
    """Return the symmetric matrix of one triangle, each entry in either of them, or of both."""
    low = np.minimum(row, column)
    high = np.maximum(row, column)
    part: Any = 0
    if file.elements is not None:
        _, part = np.unique(file.elements, return_inverse=True)
    same = _first_duplicate((part * n + row) * n + column)
    if same is not None:
        where = f"({dofs[int(row[same])]}, {dofs[int(column[same])]})"
        raise FormatError(f"entry {where} occurs twice", file.path)
    off = low != high
    pairs = ((part * n + low) * n + high)[off]
    _, index, count = np.unique(pairs, return_inverse=True, return_counts=True)
    if not off.any() or (count == 1).all():
        value = file.values
    elif (count == 2).all():
        is_upper = (row < column)[off]
        values = file.values[off]
        upper = np.zeros(len(count))
        lower = np.zeros(len(count))
        upper[index[is_upper]] = values[is_upper]
        lower[index[~is_upper]] = values[~is_upper]
        gap = np.abs(upper - lower)
        scale = float(np.abs(file.values[np.abs(file.values) < FIXED_DIAGONAL]).max(initial=0.0))
        if gap.max() > 1e-10 * scale:
            k = np.flatnonzero(off)[np.flatnonzero(index == int(gap.argmax()))[0]]
            raise FormatError(
                f"not symmetric: the entries of {dofs[int(row[k])]} and {dofs[int(column[k])]}"
                f" differ by {gap.max():.3g}",
                file.path,
            )
        value = np.where(off, file.values / 2, file.values)
    else:
        k = np.flatnonzero(off)[np.flatnonzero(count[index] == 1)[0]]
        raise FormatError(
            f"entry ({dofs[int(row[k])]}, {dofs[int(column[k])]}) is in only one triangle, others"
            " in both; expected one triangle or the whole matrix",
            file.path,
        )
    at = (np.concatenate([row, column[off]]), np.concatenate([column, row[off]]))
    entries = (np.concatenate([value, value[off]]), at)
    return sp.csr_array(sp.coo_array(entries, shape=(n, n)))


def _first_duplicate(codes: IntArray) -> int | None:
    order = np.argsort(codes, kind="stable")
    same = np.flatnonzero(np.diff(codes[order]) == 0)
    return int(order[same[0]]) if same.size else None


#: Quantities of matrix files, and their abbreviations in file names of Abaqus.
MATRICES = {"stiffness": "STIF", "mass": "MASS", "viscous": "DMPV", "structural": "DMPS"}
_INTERNAL = ("keep", "condense")


@dataclass(frozen=True, slots=True)
class AbaqusGroup:
    """A group and the files of its matrices: "stiffness", "mass", "viscous" and "structural".

    "structural" is the imaginary part of the stiffness, which gives the default of `loss_factor`.
    """

    name: str
    files: Mapping[str, AbaqusEntries]
    loss_factor: float | None = None
    origin: GroupOrigin = field(default_factory=GroupOrigin)


def assemble(
    parts: Sequence[AbaqusGroup],
    units: UnitSystem,
    path: Path,
    *,
    dofs: DofSet | None = None,
    geometry: Geometry | None = None,
    title: str = "",
    internal: str = "keep",
    held: IntArray | None = None,
) -> Model:
    """Build a model in SI units from the files of its groups, without the fixed degrees of freedom.

    `dofs` is only for files without labels. A `FormatError` is raised if structural damping is not
    a multiple of the stiffness, or an internal degree of freedom cannot be condensed.
    """
    if internal not in _INTERNAL:
        raise OptionError(f"internal {internal!r}; {suggest(str(internal), _INTERNAL)}")
    labels, known = _labels(parts, dofs, path)
    matrices: list[dict[str, Matrix]] = []
    for part in parts:
        part_matrices = {}
        for what, file in part.files.items():
            if labels is None:
                part_matrices[what] = coordinate_matrix(file, known)
            else:
                part_matrices[what] = labels.matrix(file)
        matrices.append(part_matrices)
    inner = np.zeros(len(known), dtype=np.bool_)
    if labels is not None:
        inner = labels.internal
    keep = _find_free_dofs(matrices, known, held, path)
    if internal == "condense" and (inner & keep).any():
        matrices = [_restrict_matrices(part_matrices, keep) for part_matrices in matrices]
        known = known[np.flatnonzero(keep)]
        inner = inner[keep]
        _condense(matrices, parts, known, inner, path)
        keep = ~inner
    elif geometry is None:
        _warn_of_masses(matrices, inner & keep, path)
    known = known[np.flatnonzero(keep)]
    groups = {}
    for part, part_matrices in zip(parts, matrices, strict=True):
        if part.name in groups:
            raise FormatError(f"group name {part.name!r} occurs twice", path)
        kept = _restrict_matrices(part_matrices, keep)
        si = {what: units.to_si(A, known) for what, A in kept.items()}
        groups[part.name] = _build_group(part, si, path)
    with locate_errors(path):
        return Model.from_groups(groups, known, geometry=geometry, title=title)


def _warn_of_masses(matrices: Sequence[Mapping[str, Matrix]], inner: BoolArray, path: Path) -> None:
    """Warn of internal degrees of freedom with mass, which count as translations of nodes."""
    for part_matrices in matrices:
        if "mass" in part_matrices and inner.any() and part_matrices["mass"][inner].count_nonzero():
            warnings.warn(
                f"{path}: internal degrees of freedom have mass, and no deck gives node positions:"
                " the masses in updyn info count them as translations",
                UpdynWarning,
                stacklevel=4,
            )
            return


def _restrict_matrices(
    matrices: Mapping[str, sp.csr_array], keep: BoolArray
) -> dict[str, sp.csr_array]:
    return {what: A[keep][:, keep] for what, A in matrices.items()}


def _labels(
    parts: Sequence[AbaqusGroup], dofs: DofSet | None, path: Path
) -> tuple[Labels | None, DofSet]:
    """Return the labels of the files, None if they have none, and the degrees of freedom."""
    files: list[AbaqusEntries] = []
    for part in parts:
        files += part.files.values()
    bare = [file for file in files if not file.has_labels]
    named = [file for file in files if file.has_labels]
    if bare and dofs is None:
        raise FormatError(
            "the rows have no node labels (FORMAT=COORDINATE); write them with FORMAT=MATRIX"
            ' INPUT, or give the degrees of freedom in a small TOML file: dofs = "dofs.csv"',
            bare[0].path,
        )
    if bare and named:
        raise FormatError(
            f"the rows have no node labels, unlike those of {named[0].path.name}; write all in one"
            " format",
            bare[0].path,
        )
    if not bare and dofs is not None:
        raise FormatError(
            "'dofs' is only for files without labels; the rows of these files have labels", path
        )
    if dofs is not None:
        return None, dofs
    labels = Labels.union(files)
    return labels, labels.dofs


def _find_free_dofs(
    matrices: Sequence[Mapping[str, Matrix]],
    dofs: DofSet,
    supports: IntArray | None,
    path: Path,
) -> BoolArray:
    """Return which degrees of freedom are neither fixed nor empty."""
    used = np.zeros(len(dofs), dtype=np.bool_)
    held = np.zeros(len(dofs), dtype=np.bool_)
    if supports is not None:
        codes = np.column_stack([dofs.nodes, dofs.axes + 1]) @ _CODE
        held = np.isin(codes, distinct(supports @ _CODE), assume_unique=True)
    for part_matrices in matrices:
        for what, A in part_matrices.items():
            if what == "stiffness":
                held |= A.diagonal() >= FIXED_DIAGONAL
            used[A.indices[A.data != 0.0]] = True
    empty = ~used & ~held
    if empty.any():
        first = dofs[int(np.flatnonzero(empty)[0])]
        warnings.warn(
            f"{path}: {first} has neither stiffness, mass nor damping ({int(empty.sum())} such):"
            " removed",
            UpdynWarning,
            stacklevel=4,
        )
    free: BoolArray = used & ~held
    if not free.any():
        raise FormatError("no degree of freedom is free: all are fixed", path)
    return free


def _build_group(part: AbaqusGroup, matrices: Mapping[str, Matrix], path: Path) -> Group:
    K = matrices.get("stiffness")
    D = matrices.get("structural")
    gamma = part.loss_factor or 0.0
    if D is not None:
        if part.loss_factor is not None:
            raise FormatError(
                f"group {part.name!r}: a loss factor and a structural matrix; give one of them",
                path,
            )
        gamma = _find_loss_factor(D, K, part, path)
    with locate_errors(path, f"group {part.name!r}"):
        C = matrices.get("viscous")
        group = Group(K, matrices.get("mass"), loss_factor=gamma, viscous=C)
        return group.with_origin(part.origin)


def _find_loss_factor(D: Matrix, K: Matrix | None, part: AbaqusGroup, path: Path) -> float:
    if K is None or not abs(K).max() > 0.0:
        raise FormatError(f"group {part.name!r}: structural damping without stiffness", path)
    gamma = float((D.multiply(K)).sum() / (K.multiply(K)).sum())
    level = abs(K).max() * max(abs(gamma), 1e-6)
    if abs(D - gamma * K).max() > MATRIX_FILE.damping_tolerance * level:
        raise FormatError(
            f"group {part.name!r}: structural damping is not a multiple of its stiffness; make"
            " each material a separate group",
            path,
        )
    return gamma


def _condense(
    matrices: list[dict[str, Any]],
    parts: Sequence[AbaqusGroup],
    dofs: DofSet,
    inner: BoolArray,
    path: Path,
) -> None:
    """Condense massless internal degrees of freedom out of their stiffness matrix, in place."""
    # K_rr - K_ri K_ii^-1 K_ir (Guyan 1965) is exact for massless degrees of freedom, and remains
    # proportional to the unknown of the group if they belong only to this group.
    owners = np.zeros(len(dofs), dtype=np.int64)
    for part_matrices, part in zip(matrices, parts, strict=True):
        for what, A in part_matrices.items():
            touched = np.zeros(len(dofs), dtype=np.bool_)
            touched[A.indices[A.data != 0.0]] = True
            if what in ("mass", "viscous") and (touched & inner).any():
                first = dofs[int(np.flatnonzero(touched & inner)[0])]
                raise FormatError(
                    f"group {part.name!r}: internal {first} has {what}; keep it: internal = 'keep'",
                    path,
                )
            if what == "stiffness":
                owners += touched
    shared = np.flatnonzero(inner & (owners != 1))
    if shared.size:
        raise FormatError(
            f"internal {dofs[int(shared[0])]} belongs to {owners[shared[0]]} groups; keep it:"
            " internal = 'keep'",
            path,
        )
    for part_matrices, part in zip(matrices, parts, strict=True):
        K = part_matrices.get("stiffness")
        if K is None:
            continue
        touched = np.zeros(len(dofs), dtype=np.bool_)
        touched[K.indices[K.data != 0.0]] = True
        i = np.flatnonzero(inner & touched)
        r = np.flatnonzero(~inner)
        if i.size:
            # The structural matrix is checked for proportionality before the condensation.
            gamma = (
                _find_loss_factor(part_matrices["structural"], K, part, path)
                if "structural" in part_matrices
                else None
            )
            part_matrices["stiffness"] = _schur(sp.csc_array(K), r, i, part, dofs, path)
            if gamma is not None:
                part_matrices["structural"] = part_matrices["stiffness"] * gamma


def _schur(
    K: sp.csr_array, r: IndexArray, i: IndexArray, part: AbaqusGroup, dofs: DofSet, path: Path
) -> sp.csr_array:
    from scipy.sparse.linalg import splu

    coupling = sp.csc_array(K[i][:, r])
    columns = np.unique(coupling.nonzero()[1])
    try:
        small = splu(sp.csc_array(K[i][:, i])).solve(coupling[:, columns].toarray())
    except RuntimeError as error:
        raise FormatError(
            f"group {part.name!r}: internal DOFs such as {dofs[int(i[0])]} have a singular"
            " stiffness (Lagrange multipliers); keep them: internal = 'keep'",
            path,
        ) from error
    at = r[columns]
    change = sp.coo_array(coupling[:, columns].T @ small)
    full = sp.csr_array(
        sp.coo_array((change.data, (at[change.row], at[change.col])), shape=K.shape)
    )
    return sp.csr_array(K) - (full + full.T) / 2
