"""Ansys ``.full`` files: K, M and C of the whole structure, as Mechanical APDL solved it.

Read through ansys-mapdl-reader, which returns upper triangles and counts the degrees of freedom of a node instead of
naming them; the names come from the file here (fdfull.inc: nodal extent vector and DOF vector, in which supports are
negative). Supports are no degrees of freedom of the model. The file knows no groups: with ``doubled``, runs of the deck
with one group's stiffness and density doubled, they come out by difference.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError
from updyn.io.ansys_binary import BinaryFile, labels_of, mapdl_reader
from updyn.io.guard import library, placed
from updyn.model import Group, Matrix, Model

__all__ = ["FullSystem", "read_model", "read_system"]

_KIND = 4
_FILE_HEADER = 103  # words: it follows the standard header


@dataclass(frozen=True, slots=True)
class FullSystem:
    """What a ``.full`` file holds, in SI.

    Parameters
    ----------
    stiffness, mass, viscous : sparse CSR, shape (N, N), or None
        K (N/m), M (kg), C (N s/m), both triangles, without supports.
    dofs : DofSet
        The N degrees of freedom, by node and direction.
    supports : DofSet
        Those that are constrained.
    """

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
    """Read a model.

    Parameters
    ----------
    path : path
        The file.
    unit : {"m", "mm", "in"}, optional
        Consistent units of the deck by their unit of length: m-N-kg, mm-N-t, in-lbf. Left out: those of the
        header, else SI.
    loss_factor : float
        Structural loss factor of every group; the file has none.
    doubled : mapping of str to path, optional
        By group name, the ``.full`` file of the same deck with stiffness and density of that group doubled. The groups
        have to add up to the model (1e-10). Left out: one group, "model".

    Returns
    -------
    Model
        In SI. Damping of the file (dashpots and the like) is the viscous matrix of "model", or the group "damping".

    Raises
    ------
    FormatError
        If the file is damaged, has degrees of freedom besides displacements and rotations, or holds what is not one
        symmetric structure: constraint equations, a complex or unsymmetric matrix, one part of a distributed solution.
    OptionError
        If ansys-mapdl-reader is missing or an option is not valid.
    """
    system = read_system(path, unit)
    if doubled is None:
        with placed(path):
            groups = {"model": Group(system.stiffness, system.mass, loss_factor, system.viscous)}
    else:
        groups = _by_difference(system, doubled, path, unit, loss_factor)
        if system.viscous is not None:
            groups["damping"] = Group(viscous=system.viscous)
    with placed(path):
        return Model.from_groups(groups, system.dofs)


def _by_difference(
    system: FullSystem, doubled: Mapping[str, str | Path], path: str | Path, unit: str | None, loss_factor: float
) -> dict[str, Group]:
    from updyn.io.differences import groups_by_difference

    if not isinstance(doubled, Mapping) or not doubled:
        raise OptionError(f"doubled: expected a mapping of group name to .full file, found {doubled!r}")
    if "damping" in doubled and system.viscous is not None:
        raise OptionError("doubled: 'damping' is what the file's own viscous matrix is called; choose another name")

    def of(name: str) -> tuple[Matrix | None, Matrix | None]:
        file = Path(path).parent / doubled[name]
        if not file.is_file():
            raise FormatError(f"doubled: no such file for group {name!r}", file)
        other = read_system(file, unit)
        if other.dofs != system.dofs:
            raise FormatError(f"group {name!r}: other degrees of freedom than {Path(path).name}", file)
        return other.stiffness, other.mass

    parts = groups_by_difference(doubled, (system.stiffness, system.mass), of, system.dofs, path)
    for name, (stiffness, mass) in parts.items():
        if stiffness is None and mass is None:
            raise FormatError(f"group {name!r}: {doubled[name]} has the same matrices; nothing was doubled", path)
    return {
        name: Group(stiffness, mass, 0.0 if stiffness is None else loss_factor)
        for name, (stiffness, mass) in parts.items()
    }


def read_system(path: str | Path, unit: str | None = None) -> FullSystem:
    """Read K, M and C with their degrees of freedom.

    Parameters
    ----------
    path : path
        The file.
    unit : str, optional
        As in `read_model`.

    Returns
    -------
    FullSystem
        Sorted by node and direction.

    Raises
    ------
    FormatError, OptionError
        As `read_model`.
    """
    binary = BinaryFile(path, _KIND)
    units = binary.units(unit)
    try:
        with library(path, ".full file"):
            full = mapdl_reader("full").FullFile(str(path))
    except FormatError as error:
        if isinstance(error.__cause__, NotImplementedError):
            raise FormatError(f"{error.__cause__}; {_advice(str(error.__cause__))}", path) from error
        raise
    header = full._header  # there is no public door to it
    _check_header(header, path)
    if header["ptrEND"] * 4 > Path(path).stat().st_size:
        raise FormatError(f"cut short: its end is said to be at word {header['ptrEND']}", path)
    nodes, numbers = _dof_vector(binary, header)
    free = np.flatnonzero(numbers > 0)
    dofs = labels_of(nodes, np.abs(numbers), path)
    order = free[np.lexsort((dofs.axes[free], dofs.nodes[free]))]
    kept = dofs[order]

    def matrix(pointer: str, terms: str, what: str) -> Matrix | None:
        found = _matrix(binary, full, header, (pointer, terms), what, order)
        return None if found is None else units.to_si(found, kept)

    return FullSystem(
        stiffness=matrix("ptrSTF", "ntermK", "stiffness"),
        mass=matrix("ptrMAS", "ntermM", "mass"),
        viscous=matrix("ptrDMP", "ntermD", "damping"),
        dofs=kept,
        supports=dofs[np.flatnonzero(numbers < 0)],
    )


def _advice(fault: str) -> str:
    if "lumped" in fault:
        return "solve with LUMPM,OFF, or read the .emat file"
    return "fluid, gyroscopic and friction terms make it so: expected a symmetric structure (MODOPT,LANB)"


def _check_header(header: Mapping[str, Any], path: str | Path) -> None:
    """Refuse what ansys-mapdl-reader would pass over without a word."""
    if header["fun04"] >= 0:
        raise FormatError("assembled for the frontal solver; expected symbolic assembly (EQSLV,SPARSE)", path)
    if header["ncefull"]:
        raise FormatError(
            f"holds {header['ncefull']} constraint equations (CE, CP, RBE3, contact) that are not in its K and M; give "
            "them to updyn.elements.constraints on a model read from the .emat file",
            path,
        )
    if header["nVirtBCs"]:
        raise FormatError("holds virtual constraints; expected supports and elements only", path)
    if header["distKey"]:
        raise FormatError(
            "is one part of a distributed solution; solve with -smp, or combine the parts (COMBINE)", path
        )


def _dof_vector(binary: BinaryFile, header: Mapping[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return node and DOF reference number of each equation, negative where it is constrained."""
    at = binary.after(_FILE_HEADER, "header", 2)  # and the degrees of freedom in use, of all nodes together
    nodes, _ = binary.record(at, "nodal equivalence table", "i")
    extent, at = binary.record(header["ptrDOF"], "nodal extent vector", "i")
    numbers, _ = binary.record(at, "DOF vector", "i")
    if len(extent) != len(nodes) or extent.sum() != header["neqn"] or len(numbers) != header["neqn"]:
        raise FormatError(
            f"{header['neqn']} equations, but {len(nodes)} nodes with {extent.sum()} degrees of freedom and "
            f"{len(numbers)} entries in the DOF vector: multipliers of contact or joints, or a damaged file",
            binary.path,
        )
    return np.repeat(nodes, extent).astype(np.int64), numbers.astype(np.int64)


def _matrix(
    binary: BinaryFile, full: Any, header: dict[str, Any], key: tuple[str, str], what: str, order: NDArray[np.intp]
) -> Matrix | None:
    """Return one matrix, both triangles, in the order asked for; None where the file has none."""
    pointer, terms = header[key[0]], key[1]
    if not header[terms + "l"] and not header[terms + "h"]:
        return None
    binary.after(pointer, what, 2 * header["neqn"])  # each row is two records: columns, entries
    _, entries = binary.record(pointer, what, "i")
    binary.record(entries, what, "f")  # complex ones are read as if they were real
    # The library knows K and M. Shown C in the place of K, it reads that.
    shown = {**header, "ptrSTF": pointer, "ntermKl": header[terms + "l"], "ntermKh": header[terms + "h"]}
    full._header = shown
    with library(binary.path, ".full file"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Missing mass matrix")  # said below, where it matters
        _, matrix, _ = full.load_km(as_sparse=True, sort=False)
    full._header = header
    upper = sp.csr_array(matrix)
    lower = sp.tril(upper, -1, format="csr")
    if lower.nnz:
        raise FormatError(f"{what}: {lower.nnz} entries below the diagonal; expected the upper triangle", binary.path)
    upper = upper[order][:, order]
    # Sorted rows and columns mix the triangles: what is on the diagonal counts once.
    return sp.csr_array(upper + upper.T - sp.diags_array(upper.diagonal()))
