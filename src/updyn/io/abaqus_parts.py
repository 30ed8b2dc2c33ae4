"""Matrix files of Abaqus put together as a model: labels of all, held and internal degrees of freedom, damping."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.io.abaqus_matrix import HELD, Entries, Labels, coordinate_matrix
from updyn.io.consistent_units import System
from updyn.io.guard import placed
from updyn.model import Group, Matrix, Model

__all__ = ["MATRICES", "Part", "assemble"]

#: What a matrix file can hold, and how Abaqus calls it in file names.
MATRICES = {"stiffness": "STIF", "mass": "MASS", "viscous": "DMPV", "structural": "DMPS"}
_PROPORTIONAL = 1e-8  # how far structural damping may be from a multiple of the stiffness
_INTERNAL = ("keep", "condense")


@dataclass(frozen=True, slots=True)
class Part:
    """A group and the files of its matrices.

    Parameters
    ----------
    name : str
        Group name.
    files : mapping of str to Entries
        Of "stiffness", "mass", "viscous" and "structural", the imaginary part of the stiffness.
    loss_factor : float, optional
        Structural loss factor; None: as the structural matrix says.
    """

    name: str
    files: Mapping[str, Entries]
    loss_factor: float | None = None


def assemble(
    parts: Sequence[Part],
    units: System,
    path: Path,
    *,
    dofs: DofSet | None = None,
    geometry: Geometry | None = None,
    title: str = "",
    internal: str = "keep",
    held: Sequence[tuple[int, int]] = (),
) -> Model:
    """Build a model.

    Parameters
    ----------
    parts : sequence of Part
        The groups.
    units : System
        Those of the files.
    path : Path
        The file that named them, for messages.
    dofs : DofSet, optional
        The degrees of freedom in the order of the rows; of files without labels, and of no others.
    geometry : Geometry, optional
        Where the nodes stand.
    title : str
        For the record.
    internal : {"keep", "condense"}
        What becomes of internal nodes; see `updyn.io.abaqus.read_model`.
    held : sequence of (int, int)
        Node and dof (1 to 6) of supports that are not in the matrices.

    Returns
    -------
    Model
        In SI units, without the degrees of freedom that are held.

    Raises
    ------
    FormatError
        If files do not fit each other, structural damping is no multiple of the stiffness, or an
        internal degree of freedom cannot be condensed.
    OptionError
        If `internal` is neither.
    """
    if internal not in _INTERNAL:
        raise OptionError(f"internal {internal!r}; {suggest(str(internal), _INTERNAL)}")
    labels, known = _labels(parts, dofs, path)
    matrices = [
        {
            what: coordinate_matrix(f, known) if labels is None else labels.matrix(f)
            for what, f in part.files.items()
        }
        for part in parts
    ]
    inner = np.zeros(len(known), dtype=np.bool_) if labels is None else labels.internal
    keep = _free(matrices, known, held, path)
    if internal == "condense" and (inner & keep).any():
        matrices = [{what: A[keep][:, keep] for what, A in own.items()} for own in matrices]
        known, inner = known[np.flatnonzero(keep)], inner[keep]
        _condense(matrices, parts, known, inner, path)
        keep = ~inner
    known = known[np.flatnonzero(keep)]
    groups = {}
    for part, own in zip(parts, matrices, strict=True):
        if part.name in groups:
            raise FormatError(f"group name {part.name!r} stands twice", path)
        si = {what: units.to_si(A[keep][:, keep], known) for what, A in own.items()}
        groups[part.name] = _group(part, si, path)
    with placed(path):
        return Model.from_groups(groups, known, geometry=geometry, title=title)


def _labels(parts: Sequence[Part], dofs: DofSet | None, path: Path) -> tuple[Labels | None, DofSet]:
    files = [f for part in parts for f in part.files.values()]
    bare = [f for f in files if not f.labelled]
    if bare and dofs is None:
        raise FormatError(
            "the rows say no nodes (FORMAT=COORDINATE); write them with FORMAT=MATRIX INPUT, or"
            ' name the degrees of freedom in a small TOML file: dofs = "dofs.csv"',
            bare[0].path,
        )
    if bare and len(bare) < len(files):
        named = next(f for f in files if f.labelled)
        raise FormatError(
            f"the rows say no nodes, those of {named.path.name} do; write all in one format",
            bare[0].path,
        )
    if not bare and dofs is not None:
        raise FormatError(
            "'dofs' is for files without labels; those of these files say their nodes", path
        )
    if dofs is not None:
        return None, dofs
    labels = Labels.union(files)
    return labels, labels.dofs


def _free(
    matrices: Sequence[Mapping[str, Matrix]],
    dofs: DofSet,
    supports: Sequence[tuple[int, int]],
    path: Path,
) -> NDArray[np.bool_]:
    """Return which degrees of freedom are neither held nor empty."""
    used = np.zeros(len(dofs), dtype=np.bool_)
    pairs = set(supports)
    held = np.array(
        [(n, a + 1) in pairs for n, a in zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True)]
    )
    for own in matrices:
        for what, A in own.items():
            if what == "stiffness":
                held |= A.diagonal() >= HELD
            used[A.indices[A.data != 0.0]] = True
    empty = ~used & ~held
    if empty.any():
        first = dofs[int(np.flatnonzero(empty)[0])]
        warnings.warn(
            f"{path}: {first} has neither stiffness, mass nor damping ({int(empty.sum())} such):"
            " left out",
            UpdynWarning,
            stacklevel=4,
        )
    free: NDArray[np.bool_] = used & ~held
    if not free.any():
        raise FormatError("no degree of freedom is free: everything is held", path)
    return free


def _group(part: Part, matrices: Mapping[str, Matrix], path: Path) -> Group:
    K, D = matrices.get("stiffness"), matrices.get("structural")
    gamma = part.loss_factor or 0.0
    if D is not None:
        if part.loss_factor is not None:
            raise FormatError(
                f"group {part.name!r}: a loss factor and a structural matrix; give one of them",
                path,
            )
        gamma = _ratio(D, K, part, path)
    with placed(path, f"group {part.name!r}"):
        return Group(K, matrices.get("mass"), loss_factor=gamma, viscous=matrices.get("viscous"))


def _ratio(D: Matrix, K: Matrix | None, part: Part, path: Path) -> float:
    if K is None or not abs(K).max() > 0.0:
        raise FormatError(f"group {part.name!r}: structural damping without stiffness", path)
    gamma = float((D.multiply(K)).sum() / (K.multiply(K)).sum())
    if abs(D - gamma * K).max() > _PROPORTIONAL * abs(K).max() * max(abs(gamma), 1e-6):
        raise FormatError(
            f"group {part.name!r}: structural damping is no multiple of its stiffness; give each"
            " material a group of its own",
            path,
        )
    return gamma


def _condense(
    matrices: list[dict[str, Any]],
    parts: Sequence[Part],
    dofs: DofSet,
    inner: NDArray[np.bool_],
    path: Path,
) -> None:
    """Take massless internal degrees of freedom out of the stiffness that they belong to, in place.

    K_rr - K_ri K_ii^-1 K_ir (Guyan 1965) is exact where they have no mass, and stays a multiple of
    the group's unknown where they belong to that group alone.
    """
    owners = np.zeros(len(dofs), dtype=np.int64)
    for own, part in zip(matrices, parts, strict=True):
        for what, A in own.items():
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
    if (shared := np.flatnonzero(inner & (owners != 1))).size:
        raise FormatError(
            f"internal {dofs[int(shared[0])]} belongs to {owners[shared[0]]} groups; keep it:"
            " internal = 'keep'",
            path,
        )
    for own, part in zip(matrices, parts, strict=True):
        K = own.get("stiffness")
        if K is None:
            continue
        touched = np.zeros(len(dofs), dtype=np.bool_)
        touched[K.indices[K.data != 0.0]] = True
        i, r = np.flatnonzero(inner & touched), np.flatnonzero(~inner)
        if i.size:
            # The structural matrix is proportional to the stiffness and is checked before it
            # shrinks with it.
            gamma = _ratio(own["structural"], K, part, path) if "structural" in own else None
            own["stiffness"] = _schur(sp.csc_array(K), r, i, part, dofs, path)
            if gamma is not None:
                own["structural"] = own["stiffness"] * gamma


def _schur(
    K: Any, r: NDArray[np.intp], i: NDArray[np.intp], part: Part, dofs: DofSet, path: Path
) -> Any:
    from scipy.sparse.linalg import splu

    coupling = sp.csc_array(K[i][:, r])
    columns = np.unique(coupling.nonzero()[1])
    try:
        small = splu(sp.csc_array(K[i][:, i])).solve(coupling[:, columns].toarray())
    except RuntimeError as error:
        raise FormatError(
            f"group {part.name!r}: internal {dofs[int(i[0])]} and its like have a singular"
            " stiffness (Lagrange multipliers); keep them: internal = 'keep'",
            path,
        ) from error
    at = r[columns]
    change = sp.coo_array(coupling[:, columns].T @ small)
    full = sp.csr_array(
        sp.coo_array((change.data, (at[change.row], at[change.col])), shape=K.shape)
    )
    return sp.csr_array(K) - (full + full.T) / 2
