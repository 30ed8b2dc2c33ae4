"""Native HDF5 and netCDF-4 files end with a digest, which detects any change of their bytes.

A single changed bit can send libhdf5 into an endless loop, or silently change a number. The last 78
bytes are a line ``updyn-sha256 HEX``, the SHA-256 of all bytes before it, which HDF5 ignores. A
program that opens the file for writing removes it: `updyn.foreign` then reads the file as that of
another program.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

from updyn.errors import FormatError
from updyn.foreign import box
from updyn.foreign.settings import READING
from updyn.io.atomic import write_bytes

__all__ = ["load_native", "write_native"]

_MARK = b"updyn-sha256 "
_LENGTH = len(_MARK) + 64 + 1


def write_native(content: io.BytesIO, path: str | Path) -> None:
    """Write an HDF5 file that was created in memory, with its digest."""
    # libhdf5 itself never writes to the disk, because it may end the process if the disk is full.
    with content.getbuffer() as buffer:
        write_bytes(path, buffer, _MARK + hashlib.sha256(buffer).hexdigest().encode() + b"\n")


def load_native(function: str, path: str | Path, *arguments: object, what: str) -> Any:
    """Load an HDF5 file, in this process after verification, in a child process without a digest.

    The arguments of ``"module:function"`` of `updyn.foreign` are the path, whether the digest is
    right, and `arguments`.
    """
    if _is_verified(path):
        return box.load_in_process(function, path, True, *arguments, what=what)
    return box.load(function, path, False, *arguments, what=what, reader="libhdf5")


def _is_verified(path: str | Path) -> bool:
    """Return whether a file has a digest; refuse a wrong one."""
    try:
        with Path(path).open("rb") as file:
            n_unread = file.seek(0, io.SEEK_END) - _LENGTH
            if n_unread < 0:
                return False
            file.seek(n_unread)
            line = file.read()
            if not line.startswith(_MARK):
                return False
            file.seek(0)
            digest = hashlib.sha256()
            while n_unread > 0 and (block := file.read(min(n_unread, READING.block_bytes))):
                digest.update(block)
                n_unread -= len(block)
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path) from error
    if line != _MARK + digest.hexdigest().encode() + b"\n":
        raise FormatError(
            "the content of the file differs from the content written: its digest (the SHA-256 in"
            " its last line) does not match. It is damaged, or was changed byte by byte; restore"
            " it, or write it again. If the change is intended, open the file once for writing with"
            " an HDF5 program, such as h5py.File(path, 'r+').close() in Python, which removes the"
            " digest",
            path,
        )
    return True
