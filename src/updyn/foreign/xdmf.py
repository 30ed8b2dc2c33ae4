"""XDMF files, whose numbers may be in HDF5 files of the same folder (``mesh.h5:/data0``).

meshio reads such files anywhere, follows links in them, and reports their errors for the XDMF file.
`check` checks them first.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import h5py

from updyn.errors import FormatError
from updyn.foreign.hdf5 import HDF5Content

__all__ = ["SUFFIXES", "check"]

SUFFIXES = (".xdmf", ".xmf")


def check(path: str) -> None:
    """Refuse numbers outside an XDMF file and the HDF5 files of its folder."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise FormatError(f"not a readable XDMF file ({error})", path, error.position[0]) from error
    opened: dict[str, tuple[h5py.File, HDF5Content]] = {}
    try:
        for item, place in _items(root, path):
            name, _, inner = place.partition(":")
            if name not in opened:
                opened[name] = _open_hdf5(name, path)
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


def _items(root: ElementTree.Element, path: str) -> Iterator[tuple[ElementTree.Element, str]]:
    """Yield the items whose numbers are in an HDF5 file, and their place."""
    for item in root.iter("DataItem"):
        kind = item.get("Format", "XML")
        text = (item.text or "").strip()
        if kind == "HDF" and "Reference" not in item.attrib:
            yield item, text
        elif kind == "Binary":
            raise FormatError(
                f"its numbers are in the binary file {text!r}, which is not supported; write them"
                " as HDF5 in the same folder, or into the file (Format XML)",
                path,
            )


def _open_hdf5(name: str, path: str) -> tuple[h5py.File, HDF5Content]:
    """Open an HDF5 file, which has to be in the same folder."""
    if not name or Path(name).name != name:
        raise FormatError(
            f"its numbers are in the file {name!r}; expected the name of an HDF5 file in the same"
            " folder",
            path,
        )
    file = Path(path).parent / name
    if not file.is_file():
        raise FormatError(f"no such file; {Path(path).name} refers to it for its numbers", file)
    try:
        return h5py.File(file, "r"), HDF5Content(str(file), False)
    except OSError as error:
        raise FormatError(
            f"not a readable HDF5 file: damaged, truncated, or of another format ({error});"
            f" {Path(path).name} refers to it for its numbers",
            file,
        ) from error


def _dataset(file: h5py.File, inner: str, content: HDF5Content) -> h5py.Dataset:
    """Return a dataset; all groups on its path have to be in the file."""
    found = file
    for name in filter(None, inner.split("/")):
        members = content.members(found) if isinstance(found, h5py.Group) else {}
        if name not in members:
            raise FormatError(f"no dataset {inner!r}", content.path)
        found = members[name]
    if not isinstance(found, h5py.Dataset):
        raise FormatError(f"{inner!r} is not a dataset", content.path)
    return found
