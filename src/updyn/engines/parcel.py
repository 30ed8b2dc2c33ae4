"""An object as a file that processes of this machine map into their memory.

The arrays lie in the file one after the other and are not copied when it is opened: all processes
read the same pages. Written and read by one run in a folder of its own; what a user supplies is
never read this way.
"""

from __future__ import annotations

import contextlib
import io
import mmap
import weakref
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import EngineError

__all__ = ["Parcel", "open_parcel"]

#: Arrays start at multiples of this many bytes, as vector instructions and cache lines like it.
_ALIGNED = 64


class Parcel:
    """An object, written; the file goes when nothing refers to this any more.

    Parameters
    ----------
    thing : object
        What is sent.
    path : path
        The file, which does not exist yet.

    Raises
    ------
    EngineError
        If there is no room for it.
    """

    def __init__(self, thing: Any, path: Path) -> None:
        buffers: list[Any] = []
        rest = io.BytesIO()
        pickler: Any = ForkingPickler
        pickler(rest, 5, True, buffers.append).dump(thing)  # the arrays kept apart (PEP 574)
        parts = [rest.getbuffer(), *(b.raw() for b in buffers)]
        sizes = np.array([len(parts), *(p.nbytes for p in parts)], dtype=np.int64)
        self.path = path
        weakref.finalize(self, _remove, path)
        try:
            with path.open("wb") as file:
                for part in (sizes.tobytes(), *parts):
                    file.write(part)
                    file.write(bytes(-file.tell() % _ALIGNED))
        except OSError as error:
            size = sizes[1:].sum() / 2**20
            raise EngineError(
                f"{path}: {size:.0f} MiB for the worker processes cannot be written:"
                f" {error.strerror}; the environment variable TMPDIR names another folder"
            ) from error


def open_parcel(path: Path) -> Any:
    """Return the object that was written; its arrays can be changed, which nobody else sees.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    object
    """
    with path.open("rb") as file:
        memory = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY))
    (count,) = np.frombuffer(memory, dtype=np.int64, count=1)
    sizes = np.frombuffer(memory, dtype=np.int64, count=count, offset=8)
    parts, at = [], _padded(8 + 8 * int(count))
    for size in sizes.tolist():
        parts.append(memory[at : at + size])
        at += _padded(size)
    return ForkingPickler.loads(parts[0], buffers=parts[1:])


def _padded(size: int) -> int:
    return -(-size // _ALIGNED) * _ALIGNED


def _remove(path: Path) -> None:
    with contextlib.suppress(
        OSError
    ):  # Windows keeps what a worker still has open; it goes with its folder
        path.unlink()
