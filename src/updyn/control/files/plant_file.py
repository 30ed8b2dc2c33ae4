"""Plant files: reading, writing, and the module of each format.

A new format needs one module in this folder with ``write_plant(plant, path)`` and, if it can be
read, ``read_plant(path)``, and one `Format` line below.
"""

from __future__ import annotations

from pathlib import Path

from updyn.control.plant import Plant
from updyn.errors import FormatError, OptionError, suggest
from updyn.io.formats import Format, load
from updyn.io.items import guard_reader, require_file, unreadable_error

__all__ = ["PLANT_FORMATS", "plant_format", "read_plant", "write_plant"]

_BOTH = ("read_plant", "write_plant")

PLANT_FORMATS = (
    Format("json", "updyn.control.files.json", (".json",), (b"{", b"\xef\xbb\xbf{"), _BOTH),
    Format("mat", "updyn.control.files.mat", (".mat",), (b"MATLAB ",), _BOTH),
    Format("npz", "updyn.control.files.npz", (".npz",), (b"PK\x03\x04",), _BOTH),
    Format("header", "updyn.control.files.header", (".h",), (), ("write_plant",)),
)


def write_plant(plant: Plant, path: str | Path, *, format: str | None = None) -> None:
    """Write a plant to a file, atomically.

    Parameters
    ----------
    plant : Plant
        A continuous or sampled one.
    path : path
        File to write; its suffix selects the format: ``.json`` (everything, exactly), ``.mat``
        (MATLAB), ``.npz`` (NumPy), ``.h`` (a C99 header with the matrices and a function for the
        step or the derivative).
    format : {"json", "mat", "npz", "header"}, optional
        Format; by default that of the suffix.

    Raises
    ------
    OptionError
        If `plant` is not a plant.
    FormatError
        If no format fits, or the file cannot be written.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> updyn.write_plant(made, "plant.json")
    >>> bool((updyn.read_plant("plant.json").A == made.A).all())
    True
    """
    if not isinstance(plant, Plant):
        raise OptionError(f"expected a plant, found {type(plant).__name__}")
    load(plant_format(Path(path), "write_plant", format)).write_plant(plant, path)


def read_plant(path: str | Path, *, format: str | None = None) -> Plant:
    """Read a plant written by `write_plant`.

    Parameters
    ----------
    path : path
        A ``.json``, ``.mat`` or ``.npz`` file.
    format : {"json", "mat", "npz"}, optional
        Format; by default determined from content and suffix.

    Returns
    -------
    Plant
        Equal to the written plant to the last digit.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or contains something else; file and item are named.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> updyn.write_plant(made, "plant.npz")
    >>> updyn.read_plant("plant.npz").inputs
    ('12:X',)
    """
    found = require_file(path)
    chosen = plant_format(found, "read_plant", format)
    with guard_reader(found, chosen.name):
        plant: Plant = load(chosen).read_plant(found)
    return plant


def plant_format(path: Path, verb: str, name: str | None = None) -> Format:
    """Return the format of a plant file by name, else content, else suffix; raises FormatError."""
    able = [f for f in PLANT_FORMATS if verb in f.can]
    if name is not None:
        for candidate in able:
            if candidate.name == name:
                return candidate
        raise FormatError(
            f"format {name!r} cannot {verb}; {suggest(name, [f.name for f in able])}", path
        )
    by_content: list[Format] = []
    if verb == "read_plant":
        start = _start(path)
        by_content = [f for f in able if start.startswith(f.magic)]
    by_suffix = [f for f in able if path.suffix.lower() in f.suffixes]
    for candidates in ([f for f in by_content if f in by_suffix], by_content, by_suffix):
        if candidates:
            return candidates[0]
    known = ", ".join(s for f in able for s in f.suffixes)
    hint = ""
    if path.suffix.lower() == ".h":
        hint = " (a header is for compilers: read the plant from another file)"
    raise FormatError(
        f"suffix {path.suffix!r}: no format with it can {verb}{hint}; known suffixes: {known}",
        path,
    )


def _start(path: Path) -> bytes:
    """Return the first bytes of a file without leading whitespace."""
    try:
        with path.open("rb") as file:
            start = file.read(64).lstrip()
    except OSError as error:
        raise unreadable_error(path, error) from error
    if not start:
        raise FormatError("the file is empty", path)
    return start
