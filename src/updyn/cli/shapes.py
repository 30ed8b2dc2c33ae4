"""`shapes`: the command that writes mode shapes and operating shapes for other programs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from updyn.cli.new_file import check_free, write_new
from updyn.cli.reader_options import parse_reader_options
from updyn.cli.reading import read_anything
from updyn.cli.settings import DESCRIPTION
from updyn.cli.terminal import DONE, print_text
from updyn.dynamics.modes import Modes, modes
from updyn.errors import InputError
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.io import read_geometry, write_shapes
from updyn.io.formats import find_format
from updyn.modal import ModeSet
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.updating.result import UpdateResult

__all__ = ["shapes"]


@dataclass(frozen=True, slots=True)
class _Source:
    """Modes or FRFs of a file, with the structure; None if the file has no positions of nodes."""

    shapes: ModeSet | Modes | FRF
    structure: Model | Geometry | UpdateResult | None


def shapes(
    source: Annotated[Path, Parameter("IN")],
    target: Annotated[Path, Parameter("OUT")],
    /,
    *,
    structure: Path | None = None,
    mode: list[int] | None = None,
    freq: list[float] | None = None,
    reference: str | None = None,
    quantity: str | None = None,
    unit: str | None = None,
    option: list[str] | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Write mode shapes or operating shapes as animation or for other programs.

    Parameters
    ----------
    source
        File with modes, with FRFs (then give --freq), with a model, or run.nc of a run.
    target
        File to write; its suffix selects the format: .gif, .mp4, .vtu or .unv.
    structure
        File with the model or the positions of the nodes, unless IN has them.
    mode
        Number of a mode, from 1. Repeat for more. By default all of a file, the first of a model.
    freq
        Frequency of an operating shape in Hz: the nearest line of the FRFs. Repeat for more.
    reference
        Reference of operating shapes, if the FRFs have several.
    quantity
        Measured quantity if the file does not state it.
    unit
        Unit of length of models and geometries, if the files do not state it.
    option
        KEY=VALUE: an option of the format, such as scale=0.2. Repeat for more.
    force
        Replace OUT if it exists.
    """
    if target.exists() and os.path.realpath(target) == os.path.realpath(source):
        raise InputError(f"{target}: is the file to read")
    check_free([target], force=force)
    find_format(target, "write_shapes")
    options = parse_reader_options(option, "--option")
    read = _read_source(source, freq is not None, mode, quantity, unit)
    place = read.structure
    if structure is not None:
        place = read_anything(structure, ("geometry", "model"), _unit_options(unit))[1]
    if place is None:
        raise InputError(
            f"{source}: has no positions of nodes; name the file of the model or of a geometry with"
            " --structure"
        )
    select = _select_modes(mode, read.shapes)
    write_new(
        target,
        lambda path: write_shapes(
            read.shapes,
            path,
            place,
            freq=freq,
            reference=reference,
            select=select,
            **options,
        ),
        force=force,
    )
    print_text(f"{target}: written from {read.shapes!r}")
    return DONE


def _unit_options(unit: str | None) -> dict[str, dict[str, str]]:
    """Return the options of the readers of models and of geometries."""
    given = {} if unit is None else {"unit": unit}
    return {"model": given, "geometry": given}


def _read_source(
    path: Path, is_operating: bool, mode: list[int] | None, quantity: str | None, unit: str | None
) -> _Source:
    """Return the shapes of a file with its structure."""
    options = _unit_options(unit)
    options["frf"] = {} if quantity is None else {"quantity": quantity}
    kinds = ("frf",) if is_operating else ("modes", "model", "result", "frf")
    kind, content = read_anything(path, kinds, options)
    if kind == "frf":
        return _Source(content, content.geometry)
    if kind == "modes":
        return _Source(content, _find_geometry(path, options["geometry"]))
    model = content if kind == "model" else content.model
    number = DESCRIPTION.natural_frequencies if mode is None else max(*mode, 1)
    found = modes(model, min(number, model.n_dofs))
    return _Source(found, None if model.geometry is None else content)


def _select_modes(numbers: list[int] | None, of: ModeSet | Modes | FRF) -> list[int] | None:
    if numbers is None:
        return None
    if isinstance(of, FRF):
        raise InputError("--mode: IN has FRFs and no modes; an operating shape is chosen by --freq")
    for number in numbers:
        if not 1 <= number <= len(of):
            raise InputError(f"--mode {number}: there are modes 1 to {len(of)}")
    return [number - 1 for number in numbers]


def _find_geometry(path: Path, options: Mapping[str, str]) -> Geometry | None:
    """Return the geometry in a file of modes; None if none can be read."""
    try:
        return read_geometry(path, **options)
    except InputError:
        return None
