"""Tortures of native files and of plants: single flipped bits."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

import plants_by_hand
import updyn
from native_samples import MARK, NATIVE, Native
from torture import EQUAL, OTHER, REFUSED, Outcome, Torture
from updyn.errors import FormatError


def tortures() -> list[Torture]:
    """Return the bits of every native file, and of a plant in every format that is read."""
    out = []
    for number, native in enumerate(NATIVE):
        bits = functools.partial(_flipped_bit, number)
        out.append(Torture(f"native {native.name}", "bits", bits))
    for suffix in (".json", ".mat", ".npz"):
        bits = functools.partial(_flipped_bit_of_plant, suffix)
        out.append(Torture(f"native plant{suffix}", "bits", bits))
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


@functools.cache
def _good_plant(suffix: str) -> tuple[bytes, bytes]:
    """Return the content of the file of a plant, and the plant as JSON."""
    plant = plants_by_hand.two_masses(facts=plants_by_hand.FACTS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"plant{suffix}"
        updyn.write_plant(plant, path)
        content = path.read_bytes()
        updyn.write_plant(plant, path, format="json")
        return content, path.read_bytes()


def _flipped_bit_of_plant(suffix: str, seed: int, folder: Path) -> Outcome:
    """Flip one bit: refused, or read as it was where the bit means nothing (a blank, a date)."""
    content, again = _good_plant(suffix)
    at = int(np.random.default_rng(seed).integers(8 * len(content)))
    path = folder / f"plant{suffix}"
    mutant = bytearray(content)
    mutant[at // 8] ^= 1 << at % 8
    path.write_bytes(bytes(mutant))
    try:
        found = updyn.read_plant(path)
    except FormatError as error:
        return Outcome(REFUSED, str(error))
    updyn.write_plant(found, path, format="json")
    if path.read_bytes() == again:
        return Outcome(EQUAL)
    return Outcome(OTHER, f"bit {at % 8} of byte {at // 8}", failed=True)


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
