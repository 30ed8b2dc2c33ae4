"""XDMF files, whose numbers may stand in HDF5 files beside them (``mesh.h5:/data0``).

meshio reads such a file wherever it is, follows links in it, and blames the XDMF file for whatever
is wrong with it. `check` looks at it first.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py

from updyn.errors import FormatError
from updyn.foreign.hdf5 import Content

__all__ = ["SUFFIXES", "check"]

SUFFIXES = (".xdmf", ".xmf")


def check(path: str) -> None:
    """Refuse numbers of an XDMF file that are not in it, or in an HDF5 file beside it.

    Parameters
    ----------
    path : str
        The file.

    Raises
    ------
    FormatError
        If it is no XML, or names a file in another folder, one that is not there or damaged, or
        numbers in it that are not there, of another shape, or elsewhere.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise FormatError(f"not a readable XDMF file ({error})", path, error.position[0]) from error
    opened: dict[str, tuple[Any, Content]] = {}
    try:
        for item, place in _items(root, path):
            name, _, inner = place.partition(":")
            if name not in opened:
                opened[name] = _opened(name, path)
            file, content = opened[name]
            dataset = _dataset(file, inner, content)
            content.check(dataset)
            stated = item.get("Dimensions", "").split()
            if stated != list(map(str, dataset.shape)):
                raise FormatError(
                    f"{inner}: {' x '.join(map(str, dataset.shape))} numbers, expected"
                    f" {' x '.join(stated)} by {Path(path).name}",
                    content.path,
                )
    finally:
        for file, _ in opened.values():
            file.close()


def _items(root: Any, path: str) -> Iterator[tuple[Any, str]]:
    """Yield the items whose numbers stand in an HDF5 file, and where."""
    for item in root.iter("DataItem"):
        kind = item.get("Format", "XML")
        text = (item.text or "").strip()
        if kind == "HDF" and "Reference" not in item.attrib:
            yield item, text
        elif kind == "Binary":
            raise FormatError(
                f"its numbers stand in the binary file {text!r}, which is not read; write them as"
                " HDF5 beside the file, or into it (Format XML)",
                path,
            )


def _opened(name: str, path: str) -> tuple[Any, Content]:
    """Return an open HDF5 file of a name, which has to be in the same folder."""
    if not name or Path(name).name != name:
        raise FormatError(
            f"its numbers stand in the file {name!r}; expected the name of an HDF5 file in the same"
            " folder",
            path,
        )
    file = Path(path).parent / name
    if not file.is_file():
        raise FormatError(f"no such file; {Path(path).name} says that its numbers are there", file)
    try:
        return h5py.File(file, "r"), Content(str(file), False)
    except OSError as error:
        raise FormatError(
            f"not a readable HDF5 file: damaged, cut short, or another format ({error}); the"
            f" numbers of {Path(path).name} are there",
            file,
        ) from error


def _dataset(file: Any, inner: str, content: Content) -> Any:
    """Return a dataset, through groups whose members are all in the file."""
    found = file
    for name in filter(None, inner.split("/")):
        members = content.members(found) if isinstance(found, h5py.Group) else {}
        if name not in members:
            raise FormatError(f"no dataset {inner!r}", content.path)
        found = members[name]
    if not isinstance(found, h5py.Dataset):
        raise FormatError(f"{inner!r} is no dataset", content.path)
    return found
