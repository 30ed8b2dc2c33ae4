"""Plain data as bytes and back; nothing is executed on the way.

The bytes are the length of a JSON text (8 bytes, little-endian), that text, and the numbers of all
arrays, one after the other. In the JSON text a list is a list; everything else that is not a JSON
value is a mapping with one tag::

    {"map": [[key, value], ...]}
    {"array": [dtype, shape, offset]}       offset into the numbers
    {"texts": [shape, [text, ...]]}         an array of texts of any length
    {"sparse": [shape, data, indices, indptr]}
    {"other": text}                         an unsupported item, by its type
    {"unread": text}                        an unreadable item, with the reason
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import NumberArray

__all__ = ["Other", "Sparse", "Unread", "decode", "encode", "to_native"]

_KINDS = "biufcSU"


@dataclass(frozen=True, slots=True)
class Other:
    """An item of a file of an unsupported kind."""

    kind: str


@dataclass(frozen=True, slots=True)
class Unread:
    """An item of a file that could not be read, which is an error only if it is requested."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Sparse:
    """A sparse matrix, compressed by columns, unchecked as stored in a file."""

    shape: tuple[int, int]
    data: NumberArray
    indices: NumberArray
    indptr: NumberArray


def to_native(array: NumberArray) -> NumberArray:
    """Return an array in the byte order of this machine, as required by scipy.sparse."""
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def encode(value: object) -> Iterator[bytes | memoryview]:
    """Yield the bytes of a value, part by part; raise a TypeError if it is not plain data."""
    arrays: list[NumberArray] = []
    text = json.dumps(_tag_value(value, arrays, 0)[0]).encode()
    yield len(text).to_bytes(8, "little")
    yield text
    for array in arrays:
        yield array.reshape(-1).view(np.uint8).data


def _tag_value(value: object, arrays: list[NumberArray], end: int) -> tuple[object, int]:
    if value is None or isinstance(value, bool | int | float | str):
        return value, end
    if isinstance(value, Other):
        return {"other": value.kind}, end
    if isinstance(value, Unread):
        return {"unread": value.reason}, end
    if isinstance(value, Sparse):
        parts = [list(value.shape), value.data, value.indices, value.indptr]
        tagged, end = _tag_value(parts, arrays, end)
        return {"sparse": tagged}, end
    if isinstance(value, list | tuple):
        items = []
        for item in value:
            tagged, end = _tag_value(item, arrays, end)
            items.append(tagged)
        return items, end
    if isinstance(value, Mapping):
        pairs = []
        for key, item in value.items():
            tagged, end = _tag_value(item, arrays, end)
            pairs.append([str(key), tagged])
        return {"map": pairs}, end
    if not isinstance(value, np.ndarray):
        raise TypeError(f"a {type(value).__name__} is not plain data")
    if value.dtype.kind in _KINDS and value.dtype.itemsize:
        arrays.append(np.ascontiguousarray(value))
        tag = {"array": [value.dtype.str, list(value.shape), end]}
        return tag, end + value.nbytes
    texts = value.ravel().tolist()
    if not all(isinstance(text, str) for text in texts):
        raise TypeError(f"an array of {value.dtype} is not plain data")
    return {"texts": [list(value.shape), texts]}, end


def decode(content: memoryview) -> Any:
    """Return the value encoded by `encode`; raise a ValueError for other bytes."""
    length = int.from_bytes(content[:8], "little")
    if len(content) < 8 + length:
        raise ValueError("the answer is truncated")
    return _value(json.loads(bytes(content[8 : 8 + length])), content[8 + length :])


def _value(tagged: object, numbers: memoryview) -> Any:
    if isinstance(tagged, list):
        return [_value(item, numbers) for item in tagged]
    if not isinstance(tagged, dict):
        return tagged
    ((tag, given),) = tagged.items()
    if tag not in _READERS:
        raise ValueError(f"unknown tag {tag!r}")
    return _READERS[tag](given, numbers)


def _map(given: Any, numbers: memoryview) -> dict[str, object]:
    return {str(key): _value(item, numbers) for key, item in given}


def _array(given: Any, numbers: memoryview) -> NumberArray:
    kind, shape, offset = given
    dtype = np.dtype(str(kind))
    if dtype.kind not in _KINDS or min(shape, default=0) < 0 or offset < 0:
        raise ValueError(f"an array of {dtype} and shape {shape} is not plain data")
    flat = np.frombuffer(numbers, dtype, math.prod(shape), offset)
    return flat.reshape(shape).copy()


def _texts(given: Any, numbers: memoryview) -> NumberArray:
    shape, texts = given
    out = np.empty(len(texts), dtype=object)
    out[:] = [str(text) for text in texts]
    return out.reshape(shape)


def _sparse(given: Any, numbers: memoryview) -> Sparse:
    (rows, columns), *parts = given
    data, indices, indptr = (_value(part, numbers) for part in parts)
    return Sparse((int(rows), int(columns)), data, indices, indptr)


def _other(given: object, numbers: memoryview) -> Other:
    return Other(str(given))


def _unread(given: object, numbers: memoryview) -> Unread:
    return Unread(str(given))


_READERS: Mapping[str, Callable[[object, memoryview], object]] = {
    "map": _map,
    "array": _array,
    "texts": _texts,
    "sparse": _sparse,
    "other": _other,
    "unread": _unread,
}
