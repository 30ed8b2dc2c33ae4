"""Tortures of native files: single flipped bits, and disks that are full at any size."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

from native_samples import MARK, NATIVE, Native
from torture import EQUAL, OTHER, REFUSED, Outcome, Torture
from updyn.errors import FormatError


def tortures() -> list[Torture]:
    """Return the bits of every native file, and the sizes of a disk that is too small for it."""
    out = []
    for number, native in enumerate(NATIVE):
        bits = functools.partial(_flipped_bit, number)
        out.append(Torture(f"native {native.name}", "bits", bits))
    return out


@functools.cache
def _good(number: int) -> tuple[bytes, bytes]:
    """Return the content of a native file, and of one written of what was read of it."""
    native = NATIVE[number]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / native.name
        native.write(path)
        content = path.read_bytes()
        return content, _written(native, native.read(path), path)


def _written(native: Native, found: object, path: Path) -> bytes:
    native.save(found, path)
    return path.read_bytes()


def _flipped_bit(number: int, seed: int, folder: Path) -> Outcome:
    """Flip one bit: refused, or read as it was where the bit is one of the mark of the digest."""
    native = NATIVE[number]
    content, again = _good(number)
    at = int(np.random.default_rng(seed).integers(8 * len(content)))
    mutant = bytearray(content)
    mutant[at // 8] ^= 1 << at % 8
    path = folder / native.name
    path.write_bytes(bytes(mutant))
    try:
        found = native.read(path)
    except FormatError as error:
        return Outcome(REFUSED, str(error))
    is_mark = at // 8 in range(content.rindex(MARK), content.rindex(MARK) + len(MARK))
    if is_mark and _written(native, found, path) == again:
        return Outcome(EQUAL)
    return Outcome(OTHER, f"bit {at % 8} of byte {at // 8}", failed=True)
