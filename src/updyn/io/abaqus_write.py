"""A model as a deck of Abaqus that reads its matrices: ``*MATRIX INPUT`` and ``*MATRIX ASSEMBLE``."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.geometry import Geometry
from updyn.group import VALUES
from updyn.io.abaqus_parts import MATRICES
from updyn.io.atomic import atomic_path
from updyn.io.damping import refuse_damping
from updyn.io.keyword_cards import short_number
from updyn.model import Group, Matrix, Model

__all__ = ["write_model"]

_PARAMETERS = {
    "stiffness": "STIFFNESS",
    "mass": "MASS",
    "viscous": "VISCOUS DAMPING",
    "structural": "STRUCTURAL DAMPING",
}
_LARGEST = 10**9 - 1  # node number of Abaqus


def write_model(model: Model, path: str | Path) -> None:
    """Write a model as a deck, and its matrices beside it, in SI units.

    Damping in proportion to a group's mass or stiffness goes into its viscous matrix.

    Abaqus reads numbers of up to twenty characters: an entry keeps 13 digits or more.

    Parameters
    ----------
    model : Model
        The model. Of its geometry positions are written, no lines.
    path : path
        The deck to write, for instance ``case.inp``; the matrices are called ``case_1_STIF.mtx``,
        ``case_1_MASS.mtx``, ``case_1_DMPV.mtx`` and ``case_1_DMPS.mtx`` (loss factor times
        stiffness), the number being that of the group, and are replaced where they exist. The deck
        is written last.

    Raises
    ------
    FormatError
        If the node number of a degree of freedom is not from 1 to 999999999, two groups would have
        one name, or a loss factor depends on frequency.

    Warns
    -----
    UpdynWarning
        If nodes have directions of their own, or Rayleigh coefficients have become matrices.
    """
    path = Path(path)
    _check(model, path)
    refuse_damping(model, path, *VALUES)
    if folded := [
        name for name, g in model.groups.items() if g.mass_damping or g.stiffness_damping
    ]:
        warnings.warn(
            f"{path}: Rayleigh damping of {', '.join(map(repr, folded[:6]))} is written as viscous"
            " matrices, which no longer follow mass and stiffness",
            UpdynWarning,
            stacklevel=3,
        )
    lines = ["*HEADING", _one_line(model.title) or "written by updyn"]
    lines += ["** SI units: m, N, kg, s.", *_nodes(model.geometry, path)]
    assemblies = []
    for number, (name, group) in enumerate(model.groups.items(), 1):
        named = []
        for what, matrix in _matrices(group).items():
            if matrix is None:
                continue
            file = f"{path.stem}_{number}_{MATRICES[what]}.mtx"
            with atomic_path(path.parent / file) as temporary:
                _write_matrix(matrix, model.dofs, temporary)
            label = f'"{name}_{MATRICES[what]}"'
            lines.append(f"*MATRIX INPUT, NAME={label}, INPUT={file}")
            named.append(f"{_PARAMETERS[what]}={label}")
        assemblies.append(f"*MATRIX ASSEMBLE, {', '.join(named)}")
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*lines, *assemblies]) + "\n", encoding="utf-8")


def _check(model: Model, path: Path) -> None:
    nodes = model.dofs.nodes
    if nodes.min() < 1 or nodes.max() > _LARGEST:
        bad = nodes[(nodes < 1) | (nodes > _LARGEST)][0]
        raise FormatError(f"node {bad}: Abaqus numbers nodes from 1 to {_LARGEST}", path)
    seen: dict[str, str] = {}
    for name in model.groups:
        if re.search(r'[",=]', name):
            raise FormatError(
                f"group {name!r}: a name in a deck has no quotes, commas and equals signs", path
            )
        if (other := seen.setdefault(name.upper(), name)) != name:
            raise FormatError(
                f"groups {other!r} and {name!r} are one name in a deck, where case does not matter",
                path,
            )


def _one_line(text: str) -> str:
    return " ".join(text.split()).lstrip("*")


def _nodes(geometry: Geometry | None, path: Path) -> list[str]:
    if geometry is None:
        return []
    if geometry.axes is not None:
        warnings.warn(
            f"{path}: a deck has no place for directions of nodes; left out",
            UpdynWarning,
            stacklevel=4,
        )
    places = zip(geometry.nodes.tolist(), geometry.xyz.tolist(), strict=True)
    known = [(node, xyz) for node, xyz in places if 0 < node <= _LARGEST]
    return (
        ["*NODE", *(f"{node}, {', '.join(short_number(x) for x in xyz)}" for node, xyz in known)]
        if known
        else []
    )


def _matrices(group: Group) -> dict[str, Matrix | None]:
    damped = (
        None
        if group.stiffness is None or not group.loss_factor
        else group.stiffness * group.loss_factor
    )
    return {
        "stiffness": group.stiffness,
        "mass": group.mass,
        "viscous": group.viscous_part(),
        "structural": damped,
    }


def _write_matrix(matrix: Matrix, dofs: DofSet, path: Path) -> None:
    """Write the lower triangle: node, dof, node, dof, entry."""
    entry: Any = sp.coo_array(sp.tril(matrix))
    node, direction = dofs.nodes.tolist(), (dofs.axes + 1).tolist()
    with path.open("w", encoding="ascii") as file:
        for i, j, value in zip(
            entry.row.tolist(), entry.col.tolist(), entry.data.tolist(), strict=True
        ):
            file.write(
                f"{node[i]},{direction[i]}, {node[j]},{direction[j]}, {short_number(value)}\n"
            )
