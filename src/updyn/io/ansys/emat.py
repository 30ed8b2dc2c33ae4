"""Ansys ``.emat`` files: a model whose groups are exact sums of its element matrices.

The file has the matrices before supports, but neither materials nor supports: these are read from
the ``.cdb`` or ``.rst`` file and the ``.full`` file of the same job. The sum of the groups is
compared with K and M of the ``.full`` file.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.arrays import IndexArray, IntArray, NumberArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.elements.settings import ELEMENT
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.grouping import GroupOrigin, label_groups
from updyn.io.ansys.attributes import Attributes, find_neighbour, name_groups, read_attributes
from updyn.io.ansys.binary import BinaryFile, dofs_of_nodes
from updyn.io.ansys.full import FullSystem, read_system
from updyn.io.ansys.properties import write_properties
from updyn.io.items import is_file, locate_errors, parse_selection
from updyn.io.settings import MATRIX_FILE
from updyn.model import Group, Matrix, Model

__all__ = [
    "AnsysElement",
    "ElementFile",
    "read_model",
    "write_properties",
]

_STRESS = "stress stiffness"
_KEYS = 64  # above all DOF reference numbers: combines node and number in one integer


def read_model(
    path: str | Path,
    *,
    unit: str | None = None,
    loss_factor: float = 0.0,
    by: str = "material",
    groups: Mapping[str, Iterable[int]] | None = None,
    attributes: str | Path | None = None,
    full: str | Path | bool | None = None,
    supports: Iterable[str | Dof] | None = None,
    stress_stiffness: bool | None = None,
) -> Model:
    """Read a model in SI, with one group per `by` or the element numbers `groups`.

    `attributes` and `full` are by default files of the same name in the same folder.
    `stress_stiffness` is required if the file contains stress stiffness, which forms a separate
    group.
    """
    if supports is not None and full not in (None, False):
        raise OptionError("full= and supports= both define the supports; give only one of them")
    file = ElementFile(path)
    units = file.binary.units(unit)
    known = _attributes(path, attributes)
    names = name_groups(file.elements, known, by, groups, path)
    dofs = _all_dofs(file, known)
    sums = _sum_matrices(file, names, dofs)
    whole: dict[str, dict[str, Matrix]] = {}
    for name, matrices in sums.items():
        whole[name] = {what: units.to_si(matrix, dofs) for what, matrix in matrices.items()}
    _select_stress_stiffness(whole, stress_stiffness, path)
    system = _system(path, full, unit) if supports is None else None
    keep = _free_dofs(dofs, whole, system, supports, path, is_free=full is False)
    parts: dict[str, dict[str, Matrix]] = {}
    for name, matrices in whole.items():
        parts[name] = {what: sp.csr_array(m[keep][:, keep]) for what, m in matrices.items()}
    kept = dofs[keep]
    if system is not None:
        _check_sum(parts, system, kept, path)
    geometry = None if known is None else known.geometry(units.length)
    origins = _label_groups(file.elements, names, known)
    with locate_errors(path):
        built = {
            name: _build_group(matrices, loss_factor).with_origin(origins.get(name, GroupOrigin()))
            for name, matrices in parts.items()
            if matrices
        }
        return Model.from_groups(built, kept, geometry=geometry)


def _label_groups(
    elements: IntArray, names: NDArray[np.object_], known: Attributes | None
) -> dict[str, GroupOrigin]:
    """Return the components that contain all or some elements of each group."""
    parts = {name: elements[names == name].tolist() for name in dict.fromkeys(names.tolist())}
    components = {} if known is None else known.components
    sets = {f"component {name}": set(part.tolist()) for name, part in components.items()}
    return label_groups(parts, sets)


def _attributes(path: str | Path, given: str | Path | None) -> Attributes | None:
    if given is not None:
        return read_attributes(Path(path).parent / given)
    found = find_neighbour(path, ".cdb", ".rst")
    return None if found is None else read_attributes(found)


def _system(
    path: str | Path, full: str | Path | bool | None, unit: str | None
) -> FullSystem | None:
    if isinstance(full, bool):
        if full:
            raise OptionError("full=True: expected the path of a .full file, or False")
        return None
    if full is None:
        found = find_neighbour(path, ".full")
        return None if found is None else read_system(found, unit)
    given = Path(path).parent / full
    if not is_file(given):
        raise FormatError("full: no such file", given)
    return read_system(given, unit)


# -- sums ---------------------------------------------------------------------------------------
def _all_dofs(file: ElementFile, known: Attributes | None) -> DofSet:
    """Return the degrees of freedom of all elements, sorted by node and direction."""
    path = file.binary.path
    nodes_of = {}
    if known is not None:
        nodes_of = dict(zip(known.elements.tolist(), known.nodes_of, strict=True))
    found: list[IntArray] = []
    for element in file:
        node_dofs = nodes_of.get(element.number)
        if (
            known is not None
            and node_dofs is not None
            and not np.isin(element.nodes, node_dofs).all()
        ):
            stray = element.nodes[~np.isin(element.nodes, node_dofs)][0]
            raise FormatError(
                f"element {element.number} acts on node {stray}, which it does not have in"
                f" {known.path.name}: the files belong to different models",
                path,
            )
        if element.matrices:
            found.append(element.nodes * _KEYS + element.dofs)
    if not found:
        raise FormatError("no element has a matrix", path)
    nodes, numbers = np.divmod(np.unique(np.concatenate(found)), _KEYS)
    return dofs_of_nodes(nodes, numbers, path)


def _sum_matrices(
    file: ElementFile, names: NDArray[np.object_], dofs: DofSet
) -> dict[str, dict[str, Matrix]]:
    """Return K, M, C and stress stiffness of each group, shape (N, N), in units of the deck."""
    sums: dict[str, dict[str, _ElementSum]] = {}
    keys = dofs.nodes * _KEYS + dofs.axes + 1  # ascending: sorted by node and direction
    for name, element in zip(names, file, strict=True):
        at = np.searchsorted(keys, element.nodes * _KEYS + element.dofs)
        for what, matrix in element.matrices.items():
            group = str(name)
            kind = what
            if what == _STRESS:
                group = _STRESS
                kind = "stiffness"
            if matrix.any():
                sums.setdefault(group, {}).setdefault(kind, _ElementSum(len(dofs))).add(at, matrix)
    # In the order of their names, numbers by value: "material 2" before "material 10".
    order = sorted(sums, key=lambda n: (n == _STRESS, n == "remaining", *_by_dof_number(n)))
    out = {}
    for name in order:
        out[name] = {what: total.matrix() for what, total in sums[name].items()}
    return out


def _by_dof_number(name: str) -> tuple[str, int]:
    word, _, number = name.rpartition(" ")
    return (word, int(number)) if number.isdigit() else (name, 0)


class _ElementSum:
    """A sparse sum of small matrices that limits the memory of pending entries."""

    def __init__(self, size: int) -> None:
        self._total = sp.csr_array((size, size), dtype=np.float64)
        self._pieces: list[tuple[NumberArray, NumberArray, NumberArray]] = []
        self._count = 0

    def add(self, at: IndexArray, matrix: RealArray) -> None:
        row, column = np.nonzero(matrix)
        self._pieces.append(
            (at[row].astype(np.int32), at[column].astype(np.int32), matrix[row, column])
        )
        self._count += len(row)
        if self._count > ELEMENT.pending_entries:
            self.matrix()

    def matrix(self) -> Matrix:
        if self._pieces:
            row, column, data = map(np.concatenate, zip(*self._pieces, strict=True))
            added = sp.coo_array((data, (row, column)), shape=self._total.shape)
            self._total = self._total + sp.csr_array(added)
            self._pieces = []
            self._count = 0
        return self._total


def _select_stress_stiffness(
    parts: dict[str, dict[str, Matrix]], acts: bool | None, path: str | Path
) -> None:
    if _STRESS not in parts:
        if acts:
            raise FormatError("stress_stiffness=True, but no element has any", path)
        return
    if acts is None:
        raise OptionError(
            f"{path}: elements have stress stiffness; choose whether to include it:"
            " stress_stiffness=True (PSTRES,ON, a prestressed solution) or False"
        )
    if not acts:
        del parts[_STRESS]


def _build_group(parts: Mapping[str, Matrix], loss_factor: float) -> Group:
    stiffness = parts.get("stiffness")
    if stiffness is None:
        loss_factor = 0.0
    return Group(stiffness, parts.get("mass"), loss_factor, parts.get("damping"))


# -- supports and check -------------------------------------------------------------------------
def _free_dofs(
    dofs: DofSet,
    parts: Mapping[str, Mapping[str, Matrix]],
    system: FullSystem | None,
    supports: Iterable[str | Dof] | None,
    path: str | Path,
    *,
    is_free: bool,
) -> IndexArray:
    used = np.zeros(len(dofs), dtype=np.bool_)
    for matrices in parts.values():
        for matrix in matrices.values():
            used[matrix.indices[matrix.data != 0.0]] = True
    keep = np.ones(len(dofs), dtype=np.bool_)
    if system is not None:
        missing = [d for d in system.dofs if d not in dofs]
        if missing:
            raise FormatError(
                f"the .full file has {missing[0]} ({len(missing)} such), on which no element acts:"
                " the files belong to different models",
                path,
            )
        keep[:] = False
        keep[dofs.match(system.dofs).index] = True
        free = [d for d in dofs[np.flatnonzero(~keep & used)] if d not in system.supports]
        if free:
            raise FormatError(
                f"{free[0]} ({len(free)} such) is neither free nor constrained in the .full file:"
                " the files belong to different models",
                path,
            )
    elif supports is not None:
        grounded = list(supports)
        if grounded:
            with locate_errors(path, "supports"):
                keep[dofs.match(parse_selection(grounded, "supports", path)).index] = False
    elif not is_free:
        warnings.warn(
            f"{path}: no supports are given, so the model is read as free: give full= (the .full"
            " file) or supports=, or full=False for a free structure",
            UpdynWarning,
            stacklevel=3,
        )
    unused = np.flatnonzero(keep & ~used)
    if unused.size:
        warnings.warn(
            f"{path}: {unused.size} degrees of freedom without stiffness, mass and damping are"
            f" removed; the first is {dofs[int(unused[0])]}",
            UpdynWarning,
            stacklevel=3,
        )
    return np.flatnonzero(keep & used)


def _check_sum(
    parts: Mapping[str, Mapping[str, Matrix]], system: FullSystem, dofs: DofSet, path: str | Path
) -> None:
    """Refuse groups that do not add up to the matrices assembled by Ansys."""
    at = system.dofs.match(dofs).index
    for what, total in (
        ("stiffness", system.stiffness),
        ("mass", system.mass),
        ("damping", system.viscous),
    ):
        matrices = [p[what] for p in parts.values() if what in p]
        if total is None:  # a static solution has no M, an undamped solution no C
            continue
        expected = sp.csr_array(total)[at][:, at]
        difference = sp.coo_array(sum(matrices, -expected))
        if not difference.nnz:
            continue
        scale = np.asarray(abs(expected).max(axis=1).toarray()).ravel()
        level = np.maximum(scale[difference.row], scale[difference.col])
        beyond = np.abs(difference.data) - MATRIX_FILE.sum_tolerance * level
        worst = int(np.argmax(beyond))
        if beyond[worst] > 0.0:
            i = int(difference.row[worst])
            j = int(difference.col[worst])
            raise FormatError(
                f"the element matrices do not add up to the .full file: {what} at {dofs[i]},"
                f" {dofs[j]} differs by {difference.data[worst]:.3g} (largest entry in its row or"
                f" column: {max(scale[i], scale[j]):.3g}); files of different solutions, or"
                " couplings (CE, CP, contact), which are not in element matrices",
                path,
            )


_KIND = 2
_MATRICES = ("stiffness", "mass", "damping", "stress stiffness")
_HEADER: dict[str, int | tuple[int, int]] = {
    "nume": 1,
    "numdof": 2,
    "lenbac": 4,
    "numCE": 26,
    "ptrDOF": 30,
    "ptrBAC": 31,
    "ptrElm": (32, 20),
    "ptrIDX": (37, 25),
}


@dataclass(frozen=True, slots=True)
class AnsysElement:
    """One element and its available matrices, shape (n, n), in units of the deck.

    `matrices` has "stiffness", "mass", "damping" and "stress stiffness"; `dofs` are DOF reference
    numbers.
    """

    number: int
    nodes: IntArray
    dofs: IntArray
    matrices: dict[str, RealArray]


class ElementFile:
    """An ``.emat`` file; internal constraint equations are refused."""

    def __init__(self, path: str | Path) -> None:
        self.binary = BinaryFile(path, _KIND)
        header = self.binary.header(_HEADER)
        if header["numCE"]:
            raise FormatError(
                f"holds {header['numCE']} internal constraint equations (contact, joints), which"
                " are not in element matrices",
                path,
            )
        self._used = self._table(header["ptrDOF"], "degrees of freedom per node", header["numdof"])
        self._nodes = self._table(header["ptrBAC"], "nodal equivalence table", header["lenbac"])
        self.elements = self._table(header["ptrElm"], "element equivalence table", header["nume"])
        if not len(self.elements):
            raise FormatError("holds no element", path)
        index = self._table(header["ptrIDX"], "element index table", 2 * header["nume"])
        low, high = np.split(index, 2)
        self._at = (high << 32) + (low & 0xFFFFFFFF)
        self._by_rows = True
        self._by_rows = self._packed_by_rows()

    def _table(self, at: int, what: str, length: int) -> IntArray:
        values, _ = self.binary.record(at, what, "i")
        if len(values) != length:
            raise FormatError(
                f"{what}: found {len(values)} numbers, expected {length} by the header",
                self.binary.path,
            )
        return values.astype(np.int64)

    def __iter__(self) -> Iterator[AnsysElement]:
        for i in range(len(self.elements)):
            yield self._read_element(i)

    def _read_element(self, i: int) -> AnsysElement:
        where = f"element {self.elements[i]}"
        header, at = self.binary.record(int(self._at[i]), where, "i")
        if len(header) < 10:
            raise FormatError(
                f"{where}: its header has {len(header)} numbers, expected 10", self.binary.path
            )
        size = abs(int(header[9]))
        index, at = self.binary.record(at, f"{where}: DOF index table", "i")
        if len(index) != size:
            raise FormatError(
                f"{where}: {size} rows and {len(index)} degrees of freedom; substructures"
                " (MATRIX50) are not supported",
                self.binary.path,
            )
        node, dof = np.divmod(index.astype(np.int64) - 1, len(self._used))
        if size and (node.min() < 0 or node.max() >= len(self._nodes)):
            raise FormatError(
                f"{where}: DOF index {index[np.argmax((node < 0) | (node >= len(self._nodes)))]} is"
                f" not one of {len(self._nodes)} nodes with {len(self._used)} degrees of freedom"
                " each",
                self.binary.path,
            )
        matrices = {}
        for key, what in zip(header[:4], _MATRICES, strict=True):
            if key:
                values, at = self.binary.record(at, f"{where}: {what}", "f")
                matrices[what] = self._square(values.astype(np.float64), size, f"{where}: {what}")
        return AnsysElement(int(self.elements[i]), self._nodes[node], self._used[dof], matrices)

    def _square(self, values: RealArray, size: int, where: str) -> RealArray:
        """Return the full matrix of a full, triangular or diagonal record."""
        if not np.isfinite(values).all():
            raise FormatError(f"{where} holds numbers that are not finite", self.binary.path)
        if len(values) == size * size:
            full = values.reshape(size, size)
            if size and np.abs(full - full.T).max() > 1e-10 * np.abs(full).max():
                raise FormatError(
                    f"{where} is unsymmetric; expected a symmetric structure", self.binary.path
                )
            return 0.5 * (full + full.T)
        if len(values) == size:
            return np.diag(values)
        if len(values) == size * (size + 1) // 2:
            out = np.zeros((size, size))
            places = np.tril_indices(size) if self._by_rows else np.triu_indices(size)
            out[places] = values
            return out + out.T - np.diag(out.diagonal())
        raise FormatError(
            f"{where}: {len(values)} numbers; expected those of a full, triangular or diagonal"
            f" matrix of {size} rows",
            self.binary.path,
        )

    def _packed_by_rows(self) -> bool:
        """Return whether a lower triangle is stored row by row, rather than column by column."""
        # The format description does not define this. A stiffness unpacked in the right order
        # gives no force under a rigid translation.
        difference = []
        for by_rows in (True, False):
            self._by_rows = by_rows
            rest = 0.0
            for i in range(min(len(self.elements), MATRIX_FILE.sampled_elements)):
                element = self._read_element(i)
                K = element.matrices.get("stiffness")
                if K is None or not np.any(K):
                    continue
                residual_force = 0.0
                for number in (1, 2, 3):
                    residual_force += float(np.abs(K[:, element.dofs == number].sum(axis=1)).max())
                rest += residual_force / float(np.abs(K).max())
            difference.append(rest)
        return difference[0] <= difference[1]
