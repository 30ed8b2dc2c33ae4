"""Reading a file without being told what it holds: a measurement, a model, a record of a run, modes, a plant ..."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from updyn.control.files.items import NO_PLANT
from updyn.control.files.plant_file import plant_format, read_plant
from updyn.errors import FormatError, InputError
from updyn.io import read_frf, read_geometry, read_model, read_modes
from updyn.io.formats import find_format
from updyn.store.result import read_result

__all__ = ["KINDS", "read_anything"]

#: What a file may hold, in the order in which it is tried, and the front door that reads it.
KINDS: Mapping[str, Callable[..., Any]] = {
    "frf": read_frf,
    "model": read_model,
    "result": read_result,
    "modes": read_modes,
    "geometry": read_geometry,
    "plant": read_plant,
}
_WORDS = {
    "frf": "a measurement",
    "model": "a model",
    "result": "the record of a run",
    "modes": "modes",
    "geometry": "a geometry",
    "plant": "a plant",
}


def read_anything(
    path: str | Path,
    kinds: Sequence[str] = tuple(KINDS),
    options: Mapping[str, Mapping[str, Any]] | None = None,
) -> tuple[str, Any]:
    """Read a file as the first of some kinds that it holds.

    Parameters
    ----------
    path : path
        The file.
    kinds : sequence of str
        Of `KINDS`, in the order to try.
    options : mapping of str to mapping, optional
        By kind, keyword arguments of its front door.

    Returns
    -------
    kind : str
        What it holds.
    content : FRF, Model, UpdateResult, ModeSet, Geometry or Plant
        What was read.

    Raises
    ------
    FormatError
        If it holds none of these; the message says why not, kind by kind.
    """
    path = Path(path)
    if not path.is_file() or path.stat().st_size == 0:
        find_format(path, "read_frf")  # says so; of a file that is not there it names the nearest
    reasons: dict[str, InputError] = {}
    for kind in kinds:
        try:
            return kind, KINDS[kind](path, **(options or {}).get(kind, {}))
        except InputError as error:
            reasons[kind] = error
    if len(reasons) == 1:
        raise next(iter(reasons.values()))
    told = [k for k in kinds if k in ("frf", "model") and _told_by_content(path, f"read_{k}")]
    if len(told) == 1:
        raise reasons[told[0]]
    plant = reasons.get("plant")
    if (
        plant is not None and not told and _may_be_plant(path)
    ):  # JSON, which nothing else is read from
        raise plant
    if plant is not None and told and NO_PLANT not in str(plant) and _may_be_plant(path):
        told.append("plant")
    why = "".join(
        f"\n  as {_WORDS[k]}: {_without_path(e)}"
        for k, e in reasons.items()
        if not told or k in told
    )
    raise FormatError(f"could not be read{why}", path)


def _told_by_content(path: Path, verb: str) -> bool:
    try:
        find_format(path, verb)
    except FormatError:
        return False
    return True


def _may_be_plant(path: Path) -> bool:
    try:
        plant_format(path, "read_plant")
    except FormatError:
        return False
    return True


def _without_path(error: InputError) -> str:
    text, place = str(error), getattr(error, "path", None)
    return text.removeprefix(f"{place}:").strip() if place else text
