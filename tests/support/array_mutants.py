"""Mutants of archives of arrays: one item dropped, renamed, of another type, shape or value."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_VALUES = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 2.0**63, -1.0, 0.5, 0.0)


def mutants(
    items: Mapping[str, NDArray[Any]], rng: np.random.Generator
) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield mutants without end."""
    names = list(items)
    while True:
        out = dict(items)
        name = str(rng.choice(names))
        match int(rng.integers(4)):
            case 0:
                del out[name]
            case 1:
                out[str(rng.choice([*names, name.upper(), name + "x", ""]))] = out.pop(name)
            case _:
                for _ in range(int(rng.integers(1, 3))):
                    out[name] = _changed(out[name], rng)
        yield out


def _changed(array: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    texts = array.dtype.kind in "US"
    match int(rng.integers(9)):
        case 0:
            return array.reshape(-1)[: int(rng.integers(array.size + 1))]
        case 1:
            return np.array(["", "x", "1:X", "\ud800", "1" * 5000, "{" * 2000, "inf"])
        case 2:
            return array[None]
        case 3:
            return array.T if array.ndim > 1 else array.reshape(-1, 1)
        case 4:
            return np.asarray(
                rng.choice([0, 1, -1, 2**63 - 1]), dtype=rng.choice(["i8", "f4", "?"])
            )
        case 5 if not texts:
            return array.astype(
                rng.choice(["c16", "f2", "i8", "u1", "?", "U8", "S3", "m8[s]", "f16"])
            )
        case 6:
            return np.zeros((0,) * int(rng.integers(4)))
        case 7:
            return np.concatenate([array.reshape(-1)] * 2)
        case _:
            out = array.copy().reshape(-1)
            if out.size:
                at = int(rng.integers(out.size))
                with np.errstate(all="ignore"):
                    value = rng.choice(_VALUES) if not texts else "12:Q"
                    out[at] = np.asarray(value).astype(out.dtype)
            return out.reshape(array.shape)


def archive(items: Mapping[str, NDArray[Any]]) -> bytes:
    """Return items as the bytes of an ``.npz`` archive."""
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **items)
    return out.getvalue()


def changed_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with a few bytes changed, cut or repeated."""
    out = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(out)))
        match int(rng.integers(4)):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at] = int(rng.integers(256))
            case 2:
                del out[at : at + int(rng.integers(1, 64))]
            case _:
                out[at:at] = out[at : at + int(rng.integers(1, 64))]
        if not out:
            return b""
    return bytes(out)
