"""Native HDF5 and netCDF-4 files end with a digest, so that what was written is what is read.

A single bit that changed can send libhdf5 into an endless loop, or change a number without a word.
So the digest covers every byte of the file and is checked without parsing any of it. The last 78
bytes of a native file are one line of text::

    updyn-sha256 HEX

with the SHA-256 of all bytes before that line. HDF5 ignores what follows the end of its data, so
that h5py, xarray and the netCDF library open the file. A program that opens it for writing cuts it
off at the end of the data, and so removes the digest: it is then a file of another program, which
is read by `updyn.foreign`.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

from updyn.errors import FormatError
from updyn.foreign import box
from updyn.io.atomic import write_bytes

__all__ = ["load_native", "write_native"]

_MARK = b"updyn-sha256 "
_LENGTH = len(_MARK) + 64 + 1
_BLOCK = 2**20  # bytes


def write_native(content: io.BytesIO, path: str | Path) -> None:
    """Write an HDF5 file that was made in memory, with its digest.

    libhdf5 itself never writes to the disk: where that is full, it may end the process.

    Parameters
    ----------
    content : io.BytesIO
        The file.
    path : path
        Where to.
    """
    with content.getbuffer() as made:
        write_bytes(path, made, _MARK + hashlib.sha256(made).hexdigest().encode() + b"\n")


def load_native(function: str, path: str | Path, *arguments: Any, what: str) -> Any:
    """Load an HDF5 file: in this process if its digest is right, in a child process if it has none.

    Parameters
    ----------
    function : str
        ``"module:function"`` of `updyn.foreign`; it takes the path, whether the file is ours, and
        `arguments`.
    path : path
        The file.
    *arguments : object
        More arguments.
    what : str
        What the file should be, for messages.

    Returns
    -------
    object
        What the function returned, plain data.

    Raises
    ------
    FormatError
        If the file has a digest that is not that of its content, or cannot be read.
    """
    if _is_verified(path):
        return box.load_here(function, path, True, *arguments, what=what)
    return box.load(function, path, False, *arguments, what=what, reader="libhdf5")


def _is_verified(path: str | Path) -> bool:
    """Check the digest of a file, and return whether it has one."""
    try:
        with Path(path).open("rb") as file:
            left = file.seek(0, io.SEEK_END) - _LENGTH
            if left < 0:
                return False
            file.seek(left)
            line = file.read()
            if not line.startswith(_MARK):
                return False
            file.seek(0)
            digest = hashlib.sha256()
            while left > 0 and (block := file.read(min(left, _BLOCK))):
                digest.update(block)
                left -= len(block)
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path) from error
    if line != _MARK + digest.hexdigest().encode() + b"\n":
        raise FormatError(
            "the content of the file is not what was written: its digest (the SHA-256 in its last"
            " line) is another one. It is damaged, or was changed byte by byte; restore it, or"
            " write it again. If the change is wanted, open the file once for writing with an HDF5"
            " program, such as h5py.File(path, 'r+').close() in Python, which removes the digest",
            path,
        )
    return True
