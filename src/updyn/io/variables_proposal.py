"""A proposal of ``variables`` for a file whose variables do not have the names of the format.

Frequencies, values and coherence are guessed from names, types and shapes; the user confirms them
by stating ``variables``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import AbsentError, FormatError
from updyn.io.csv_proposal import FREQUENCY, UNKNOWN, WORDS, has_word
from updyn.io.items import Items
from updyn.io.settings import FILE_TEXT
from updyn.io.toml_text import format_mapping

__all__ = ["flatten", "guess_variables", "proposing_variables"]

#: Names in files of the formats, for which other messages have the remedy.
_STANDARD = ("H", "values", "K", "M", "updyn_kind")
_PARTS = ("real", "imaginary")
_COHERENCE = ("coh", "gamma", "cxy")


@contextmanager
def proposing_variables(found: Items) -> Iterator[None]:
    """Add the arrays and a proposal to a `FormatError`, if the file has other names of FRFs."""
    try:
        yield
    except FormatError as error:
        arrays = {} if any(name in found for name in _STANDARD) else flatten(found)
        proposal = guess_variables(arrays)
        if proposal is None:
            raise
        kind = AbsentError if isinstance(error, AbsentError) else FormatError
        out = kind(
            f"{error}\nArrays: {_format_arrays(arrays)}\nIf they are FRFs, select them"
            " with variables in [test] of a job, --test-option of updyn new, or variables= of"
            " updyn.read_frf; state labels"
            f" and quantity, too:\nvariables = {format_mapping(proposal)}",
            key=error.key,
        )
        out.path, out.line = error.path, error.line
        raise out from error


def flatten(found: Items, before: str = "") -> dict[str, NumberArray]:
    """Return the arrays of numbers by dotted name."""
    out: dict[str, NumberArray] = {}
    for name, item in found.items():
        if isinstance(item, Mapping):
            out |= flatten(item, f"{before}{name}.")
        elif isinstance(item, np.ndarray) and item.dtype.kind in "iufc":
            out[before + name] = item
    return out


def guess_variables(arrays: Mapping[str, NumberArray]) -> dict[str, object] | None:
    """Return ``variables`` by an array of values or by tables; None without both."""
    tables = [name for name, array in arrays.items() if _is_table(array)]
    for freq, lines in arrays.items():
        if not (has_word(freq.split(".")[-1], (*FREQUENCY, "w")) and _is_axis(lines)):
            continue
        rest = {k: v for k, v in arrays.items() if k not in (*tables, freq)}
        names = _find_values({k: v for k, v in rest.items() if lines.size in v.shape})
        if names:
            return {"freq": freq, **names}
    if not tables:
        return None
    channels = [
        {"response": UNKNOWN, "reference": UNKNOWN, "complex": f"{name}(:,2)"} for name in tables
    ]
    return {"freq": f"{tables[0]}(:,1)", "channels": channels}


def _find_values(arrays: Mapping[str, NumberArray]) -> dict[str, str]:
    """Return the variables of values or their parts, and of a coherence; empty without values."""
    names = {"H": next((k for k, v in arrays.items() if v.dtype.kind == "c"), "")}
    if not names["H"]:
        names = {part: _find_name(arrays, WORDS[part]) for part in _PARTS}
    if not all(names.values()):
        return {}
    shape = arrays[next(iter(names.values()))].shape
    coherence = _find_name({k: v for k, v in arrays.items() if v.shape == shape}, _COHERENCE)
    return {**names, "coherence": coherence} if coherence else names


def _find_name(arrays: Mapping[str, NumberArray], words: Sequence[str]) -> str:
    """Return the first name with one of the words; empty without one."""
    return next((name for name in arrays if has_word(name.split(".")[-1], words)), "")


def _is_axis(array: NumberArray) -> bool:
    """Return whether an array has increasing real numbers in one row or column."""
    if array.size < 2 or array.size != max(array.shape) or array.dtype.kind == "c":
        return False
    return bool((np.diff(array.reshape(-1)) > 0).all())


def _is_table(array: NumberArray) -> bool:
    """Return whether an array has increasing frequencies and complex values in two columns."""
    if array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind != "c":
        return False
    return not array[:, 0].imag.any() and _is_axis(array[:, 0].real)


def _format_arrays(arrays: Mapping[str, NumberArray]) -> str:
    """Return names and shapes, for messages."""
    most = FILE_TEXT.listed_columns
    texts = []
    for name, array in list(arrays.items())[:most]:
        kind = "complex" if array.dtype.kind == "c" else "real"
        texts.append(f"{name} ({kind}, {' x '.join(map(str, array.shape)) or '1'})")
    return ", ".join(texts) + (", ..." if len(arrays) > most else "")
