"""Mesh files (Gmsh, VTK, MED): structures, with a material for each physical group."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from updyn.errors import OptionError
from updyn.io.items import locate_errors
from updyn.model import Model

__all__ = ["read_model"]


def read_model(
    path: str | Path,
    *,
    unit: str | None = None,
    materials: Mapping[str, Mapping[str, object]] | None = None,
    leave_out: Iterable[str] = (),
    ungrouped: str = "error",
    grounded: Iterable[str | int] = (),
) -> Model:
    """Read a mesh and build a model from materials in SI units by physical group.

    `unit` is required, because no format states it. The other options are those of
    `updyn.elements.mesh.structure_from_mesh`.
    """
    from updyn.elements.mesh import structure_from_mesh
    from updyn.elements.structure.beams import section_from_table

    for name, given in (("unit", unit), ("materials", materials)):
        if given is None:
            raise OptionError(
                f"{path}: a mesh does not contain its {name}; expected the option {name!r}"
            )
    if not isinstance(materials, Mapping) or not all(
        isinstance(m, Mapping) for m in materials.values()
    ):
        raise OptionError(f"{path}: materials: expected a table for each group")
    with locate_errors(path):
        group_materials = {group: dict(material) for group, material in materials.items()}
        for group, material in group_materials.items():
            if isinstance(material.get("section"), Mapping):
                material["section"] = section_from_table(group, material["section"])
        return structure_from_mesh(
            path,
            group_materials,
            unit=str(unit),
            leave_out=leave_out,
            ungrouped=ungrouped,
            grounded=grounded,
        )
