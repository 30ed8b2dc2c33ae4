"""`structure_from_table`: a structure from the tables of a job file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.elements.checks import check_keys, from_row
from updyn.elements.constraints import Equation
from updyn.elements.structure.build import structure
from updyn.elements.structure.parts import Beam, PointMass, RigidLink, Shell, Solid, Spring, Truss
from updyn.elements.structure.sections import section_from_table
from updyn.errors import ModelError
from updyn.model import Model

__all__ = ["structure_from_table"]

_PARTS: dict[str, type[Any]] = {
    "beam": Beam,
    "truss": Truss,
    "shell": Shell,
    "solid": Solid,
    "spring": Spring,
    "mass": PointMass,
}


def structure_from_table(table: Mapping[str, Any]) -> Model:
    """Build a structure from a table of a job file, ``[model] kind = "structure"``.

    Parameters
    ----------
    table : mapping
        ``kind`` (``"structure"``, may be left out); ``nodes``, a table from node number to position
        in m; arrays of tables ``beam``, ``truss``, ``shell``, ``solid``, ``spring``, ``mass`` and
        ``link`` with the fields of `Beam`, `Truss`, `Shell`, `Solid`, `Spring`, `PointMass` and
        `RigidLink`; ``equation`` with ``dof`` and ``terms``; ``grounded``, an array of DOFs and
        node numbers; ``title``. The ``section`` of a beam is a table with the fields of `Section`,
        or with ``shape`` ``"rectangle"`` or ``"tube"`` and its dimensions.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If a key is missing or unknown (the nearest is named), or as `structure`.
    """
    data = dict(table)
    kind = data.pop("kind", "structure")
    if kind != "structure":
        raise ModelError(f"model: kind {kind!r}; expected 'structure'")
    check_keys("model", data, ["nodes"], [*_PARTS, "link", "equation", "grounded", "title"])
    parts = []
    for key, part in _PARTS.items():
        for number, row in enumerate(_rows(data, key), 1):
            if key == "beam" and isinstance(row, Mapping) and "section" in row:
                row = {
                    **row,
                    "section": section_from_table(f"model.beam, number {number}", row["section"]),
                }
            parts.append(from_row(part, key, number, row))
    links = [
        from_row(RigidLink, "link", number, row)
        for number, row in enumerate(_rows(data, "link"), 1)
    ]
    equations = []
    for number, row in enumerate(_rows(data, "equation"), 1):
        where = f"model.equation, number {number}"
        if not isinstance(row, Mapping):
            raise ModelError(f"{where}: expected a table, found {row!r}")
        check_keys(where, row, ("dof", "terms"), ())
        if not isinstance(row["terms"], Mapping):
            raise ModelError(
                f"{where}: terms {row['terms']!r}; expected a table from DOF to coefficient"
            )
        equations.append(Equation(row["dof"], row["terms"]))
    grounded = data.get("grounded", [])
    if not isinstance(grounded, list | tuple):
        raise ModelError(
            f"model: grounded {grounded!r}; expected an array of DOFs and node numbers"
        )
    return structure(
        _nodes(data["nodes"]),
        parts,
        links=links,
        equations=equations,
        grounded=grounded,
        title=data.get("title", ""),
    )


def _rows(data: Mapping[str, Any], key: str) -> list[Any]:
    rows = data.get(key, [])
    if not isinstance(rows, list | tuple):
        raise ModelError(
            f"model: {key} holds {type(rows).__name__}; expected an array of tables,"
            f" [[model.{key}]]"
        )
    return list(rows)


def _nodes(table: Any) -> dict[int, Any]:
    if not isinstance(table, Mapping):
        raise ModelError(
            f"model: nodes holds {type(table).__name__}; expected a table from node number to"
            " position"
        )
    out: dict[int, Any] = {}
    for key, position in table.items():
        text = str(key)
        if not text.isdecimal():
            raise ModelError(f"model.nodes: {key!r}; expected a node number")
        if not isinstance(position, list | tuple) or len(position) != 3:
            raise ModelError(
                f"model.nodes: node {text} stands at {position!r}; expected three numbers"
            )
        if int(text) in out:
            raise ModelError(f"model.nodes: node {int(text)} stands twice")
        out[int(text)] = position
    return out
