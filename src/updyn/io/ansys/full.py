"""Ansys ``.full`` files: K, M and C of the whole structure, as solved by Mechanical APDL.

A row of a matrix is two records, columns and entries, of one triangle (fdfull.inc). Supports are
negative in the DOF vector and not degrees of freedom of the model. The file contains no groups:
they are computed by difference from runs with doubled stiffness and density of a group.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, IntArray, NumberArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError
from updyn.io.ansys.binary import BinaryFile, dofs_of_nodes
from updyn.io.ansys.properties import write_properties
from updyn.io.differences import groups_by_difference
from updyn.io.items import is_file, locate_errors
from updyn.model import Group, Matrix, Model

__all__ = ["FullSystem", "read_model", "read_system", "write_properties"]

_KIND = 4
_FILE_HEADER = 103  # words, after the standard header
#: Positions of items in the file header; for long items the low and the high half (fdfull.inc).
_ITEMS: dict[str, int | tuple[int, int]] = {
    "fun04": 0,
    "neqn": 1,
    "ntermK": (8, 9),
    "lumpm": 10,
    "keyuns": 13,
    "ptrSTF": (18, 19),
    "ncefull": 20,
    "ntermM": (33, 21),
    "ptrEND": (22, 23),
    "ptrMAS": (26, 27),
    "ptrDMP": (28, 29),
    "ntermD": (34, 39),
    "ptrDOF": (35, 36),
    "distKey": 62,
    "nVirtBCs": 79,
}


@dataclass(frozen=True, slots=True)
class FullSystem:
    """The content of a ``.full`` file in SI; both triangles of K, M and C, without supports."""

    stiffness: Matrix | None
    mass: Matrix | None
    viscous: Matrix | None
    dofs: DofSet
    supports: DofSet


def read_model(
    path: str | Path,
    *,
    unit: str | None = None,
    loss_factor: float = 0.0,
    doubled: Mapping[str, str | Path] | None = None,
) -> Model:
    """Read a model in SI as one group "model", or as groups by difference from files in `doubled`.

    `doubled` has, by group, the file of a run with stiffness and density of the group doubled.
    Damping of the file is the viscous matrix of "model", or the group "damping".
    """
    system = read_system(path, unit)
    if doubled is None:
        with locate_errors(path):
            groups = {"model": Group(system.stiffness, system.mass, loss_factor, system.viscous)}
    else:
        groups = _groups_by_difference(system, doubled, path, unit, loss_factor)
        if system.viscous is not None:
            groups["damping"] = Group(viscous=system.viscous)
    with locate_errors(path):
        return Model.from_groups(groups, system.dofs)


def _groups_by_difference(
    system: FullSystem,
    doubled: Mapping[str, str | Path],
    path: str | Path,
    unit: str | None,
    loss_factor: float,
) -> dict[str, Group]:
    if not isinstance(doubled, Mapping) or not doubled:
        raise OptionError(
            f"doubled: expected a mapping of group name to .full file, found {doubled!r}"
        )
    if "damping" in doubled and system.viscous is not None:
        raise OptionError(
            "doubled: the name 'damping' is reserved for the viscous matrix of the file; choose"
            " another name"
        )

    def of(name: str) -> tuple[Matrix | None, Matrix | None]:
        file = Path(path).parent / doubled[name]
        if not is_file(file):
            raise FormatError(f"doubled: no such file for group {name!r}", file)
        other = read_system(file, unit)
        if other.dofs != system.dofs:
            raise FormatError(
                f"group {name!r}: degrees of freedom differ from {Path(path).name}", file
            )
        return other.stiffness, other.mass

    parts = groups_by_difference(doubled, (system.stiffness, system.mass), of, system.dofs, path)
    groups = {}
    for name, (stiffness, mass) in parts.items():
        if stiffness is None and mass is None:
            raise FormatError(
                f"group {name!r}: {doubled[name]} has the same matrices; nothing was doubled", path
            )
        gamma = 0.0 if stiffness is None else loss_factor
        groups[name] = Group(stiffness, mass, gamma)
    return groups


def read_system(path: str | Path, unit: str | None = None) -> FullSystem:
    """Read K, M and C with their degrees of freedom, sorted by node and direction."""
    binary = BinaryFile(path, _KIND)
    units = binary.units(unit)
    header = binary.header(_ITEMS)
    _check_header(header, path)
    nodes, numbers = _dof_vector(binary, header)
    free = np.flatnonzero(numbers > 0)
    dofs = dofs_of_nodes(nodes, np.abs(numbers), path)
    order = free[np.lexsort((dofs.axes[free], dofs.nodes[free]))]
    kept = dofs[order]

    def matrix(pointer: str, terms: str, what: str) -> Matrix | None:
        if not header[terms]:
            return None
        found = _matrix(binary, header["neqn"], header[pointer], what, order, header[terms])
        return units.to_si(found, kept)

    return FullSystem(
        stiffness=matrix("ptrSTF", "ntermK", "stiffness"),
        mass=matrix("ptrMAS", "ntermM", "mass"),
        viscous=matrix("ptrDMP", "ntermD", "damping"),
        dofs=kept,
        supports=dofs[np.flatnonzero(numbers < 0)],
    )


def _check_header(header: Mapping[str, int], path: str | Path) -> None:
    """Refuse properties of the file that the matrices do not show."""
    if header["ptrEND"] * 4 > Path(path).stat().st_size:
        raise FormatError(f"truncated: the header places its end at word {header['ptrEND']}", path)
    if header["lumpm"]:
        raise FormatError(
            "holds a lumped mass matrix; solve with LUMPM,OFF, or read the .emat file", path
        )
    if header["keyuns"]:
        raise FormatError(
            "holds unsymmetric matrices (of fluid, gyroscopic or friction terms); expected a"
            " symmetric structure (MODOPT,LANB)",
            path,
        )
    if header["fun04"] >= 0:
        raise FormatError(
            "assembled for the frontal solver; expected symbolic assembly (EQSLV,SPARSE)", path
        )
    if header["ncefull"]:
        raise FormatError(
            f"holds {header['ncefull']} constraint equations (CE, CP, RBE3, contact) that are not"
            " in its K and M; give them to updyn.elements.constraints on a model read from the"
            " .emat file",
            path,
        )
    if header["nVirtBCs"]:
        raise FormatError("holds virtual constraints; expected only supports and elements", path)
    if header["distKey"]:
        raise FormatError(
            "is one part of a distributed solution; solve with -smp, or combine the parts"
            " (COMBINE)",
            path,
        )


def _dof_vector(binary: BinaryFile, header: Mapping[str, int]) -> tuple[IntArray, IntArray]:
    """Return node and DOF reference number of each equation; constrained ones are negative."""
    # The record after the header holds the degrees of freedom that any node uses.
    at = binary.after(_FILE_HEADER, "header", 2)
    nodes, _ = binary.record(at, "nodal equivalence table", "i")
    extent, at = binary.record(header["ptrDOF"], "nodal extent vector", "i")
    numbers, _ = binary.record(at, "DOF vector", "i")
    if (
        len(extent) != len(nodes)
        or extent.sum() != header["neqn"]
        or len(numbers) != header["neqn"]
    ):
        raise FormatError(
            f"{header['neqn']} equations, but {len(nodes)} nodes with {extent.sum()} degrees of"
            f" freedom and {len(numbers)} entries in the DOF vector: multipliers of contact or"
            " joints, or a damaged file",
            binary.path,
        )
    return np.repeat(nodes, extent).astype(np.int64), numbers.astype(np.int64)


def _matrix(
    binary: BinaryFile, size: int, at: int, what: str, order: IndexArray, terms: int
) -> Matrix:
    """Return both triangles of the matrix that starts at word `at`, in the order `order`."""
    columns: list[NumberArray] = []
    entries: list[NumberArray] = []
    for _ in range(size):
        column, at = binary.record(at, what, "i")
        entry, at = binary.record(at, what, "f")
        if len(entry) != len(column):
            raise FormatError(
                f"{what}: row {len(columns) + 1} has {len(column)} columns and {len(entry)}"
                " numbers; complex matrices of a harmonic solution are not supported",
                binary.path,
            )
        columns.append(column)
        entries.append(entry)
    row = np.repeat(np.arange(size), list(map(len, columns)))
    column = np.concatenate(columns).astype(np.int64) - 1
    data = np.concatenate(entries).astype(np.float64)
    if len(column) != terms:
        raise FormatError(
            f"{what}: {len(column)} entries, expected {terms} by the header: damaged", binary.path
        )
    if column.min() < 0 or column.max() >= size:
        raise FormatError(f"{what}: a column outside of 1 to {size}: damaged", binary.path)
    if (column < row).any() and (column > row).any():
        raise FormatError(
            f"{what}: entries on both sides of the diagonal; expected one triangle", binary.path
        )
    if not np.isfinite(data).all():
        raise FormatError(f"{what}: holds numbers that are not finite", binary.path)
    whole = sp.csr_array(sp.coo_array((data, (row, column)), shape=(size, size)))
    triangle = whole[order][:, order]
    return sp.csr_array(triangle + triangle.T - sp.diags_array(triangle.diagonal()))
