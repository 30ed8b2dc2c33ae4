"""Mixed values (options, figures, advice) as JSON text: exactly, or plainly for other programs.

`to_text` marks inf, nan, tuples, arrays and complex numbers (``{"__float__": "inf"}``), which JSON
lacks, for exact recovery by `from_text`. `plain` does not mark them.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from updyn.dofs import Dof, DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.modal.mode_set import ModeSet
from updyn.store.settings import STORED_ARRAY

__all__ = ["from_text", "plain", "plain_fields", "plain_records", "to_text"]

_MODES = ("frequency", "shapes", "dofs", "loss_factor", "scaled", "quality", "source")
_STD = ("std_frequency", "std_loss_factor", "std_shapes", "cov_frequency")


def to_text(value: object, what: str) -> str:
    """Return strict JSON from which `from_text` restores `value`.

    An object of another type (a solver, a client) is stored as its text, with an `UpdynWarning` on
    `what`.
    """
    return json.dumps(_mark_value(value, what), allow_nan=False, ensure_ascii=False)


def _mark_value(value: Any, what: str) -> object:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"__float__": repr(value)}
    if isinstance(value, complex):
        return {"__complex__": _mark_value([value.real, value.imag], what)}
    if isinstance(value, list):
        return [_mark_value(v, what) for v in value]
    if isinstance(value, tuple):
        return {"__tuple__": _mark_value(list(value), what)}
    if isinstance(value, DofSet):
        return {"__dofs__": value.labels}
    if isinstance(value, Dof):
        return {"__dof__": str(value)}
    if isinstance(value, ModeSet):
        return {"__modes__": _mark_value(_fields(value, (*_MODES, *_STD)), what)}
    is_kept = isinstance(value, np.ndarray) and value.dtype.itemsize <= STORED_ARRAY.entry_bytes
    if is_kept and value.dtype.kind in "biufcU":
        items = _mark_value(value.ravel().tolist(), what)
        return {"__array__": items, "dtype": value.dtype.str, "shape": list(value.shape)}
    if isinstance(value, Mapping):
        if all(isinstance(k, str) and not k.startswith("__") for k in value):
            return {k: _mark_value(v, what) for k, v in value.items()}
        return {"__pairs__": _mark_value(list(map(list, value.items())), what)}
    kind = type(value).__name__
    warnings.warn(
        f"{what} contains a {kind}, which cannot be stored: its text {str(value)!r} is stored"
        " instead",
        UpdynWarning,
        stacklevel=3,
    )
    return str(value)


_RESTORE: dict[str, Callable[[dict[str, Any]], object]] = {
    "__float__": lambda v: float(v["__float__"]),
    "__complex__": lambda v: complex(*_restore_value(v["__complex__"])),
    "__tuple__": lambda v: tuple(_restore_value(v["__tuple__"])),
    "__dofs__": lambda v: DofSet(v["__dofs__"]),
    "__modes__": lambda v: ModeSet(**_restore_value(v["__modes__"])),
    "__dof__": lambda v: Dof.parse(v["__dof__"]),
    "__pairs__": lambda v: dict(_restore_value(v["__pairs__"])),
    "__array__": lambda v: np.array(_restore_value(v["__array__"]), _dtype(v)).reshape(v["shape"]),
}


def _dtype(stored: dict[str, Any]) -> np.dtype[np.generic]:
    """Return the type of a stored array; refuse long texts, which would be mostly padding."""
    dtype: np.dtype[np.generic] = np.dtype(stored["dtype"])
    if dtype.itemsize > STORED_ARRAY.entry_bytes:
        raise ValueError(f"an array of {dtype}")
    return dtype


def from_text(text: str, what: str, path: str | Path) -> Any:
    """Return the value stored by `to_text`; raise a FormatError for other texts."""
    try:
        return _restore_value(json.loads(text, parse_constant=_refuse, parse_int=_whole))
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        raise FormatError(f"{what}: not JSON as updyn writes it ({error})", path) from error


def _restore_value(value: Any) -> Any:
    if isinstance(value, list):
        return [_restore_value(v) for v in value]
    if not isinstance(value, dict):
        return value
    for key in value:
        if key.startswith("__"):
            return _RESTORE[key](value)
    return {key: _restore_value(v) for key, v in value.items()}


def _whole(digits: str) -> int:
    """Return an integer in the range of floating-point numbers, to prevent later overflows."""
    number = int(digits)
    float(number)
    return number


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def plain(value: object) -> Any:
    """Return strict JSON values: inf and nan as None, arrays as lists, other objects as text."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, DofSet):
        return value.labels
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return str(value)


def plain_fields(record: object, *names: str) -> dict[str, Any]:
    """Return attributes of a record by name, as strict JSON values."""
    return plain(_fields(record, names))  # type: ignore[no-any-return]


def plain_records(records: Iterable[Any]) -> list[Any]:
    """Return dataclasses with all their fields, as strict JSON values."""
    return plain(list(map(asdict, records)))  # type: ignore[no-any-return]


def _fields(record: object, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(record, name) for name in names}
