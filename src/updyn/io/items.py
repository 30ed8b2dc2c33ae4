"""Checks and conversions of the items of a file: arrays, matrices, texts, DOFs.

Libraries that read archives raise many kinds of exceptions for damaged files.
`report_library_errors` catches them only around the call into the library, which does not hide
errors of updyn.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IntArray, NumberArray
from updyn.dofs import Dof, DofSet
from updyn.errors import (
    FormatError,
    InputError,
    OptionError,
    UpdynError,
    damaged,
    key_path,
    reason_of,
    suggest,
)
from updyn.foreign.plain import Unread
from updyn.model import Matrix

__all__ = [
    "FAILURES",
    "Items",
    "as_dofs",
    "as_integers",
    "as_matrix",
    "as_number",
    "as_numbers",
    "as_reals",
    "as_text",
    "as_vector",
    "build_sparse",
    "check_names",
    "check_phase",
    "describe_kind",
    "format_counts",
    "format_key",
    "format_names",
    "guard_reader",
    "is_file",
    "is_folder",
    "locate_errors",
    "parse_selection",
    "read_utf8",
    "read_windows_text",
    "refuse_repeated_names",
    "report_library_errors",
    "require_file",
    "suggest_file",
    "unreadable_error",
]

Items = Mapping[str, object]
#: Longest name of a file.
_LONGEST_NAME = 255


def build_sparse(
    make: Any,
    data: NumberArray,
    indices: NumberArray,
    indptr: NumberArray,
    shape: tuple[int, int],
    where: str,
    path: str | Path,
) -> Matrix:
    """Return a sparse matrix from its three arrays, after checking their consistency."""
    for name, array, kinds in (
        ("data", data, "biufc"),
        ("indices", indices, "iu"),
        ("indptr", indptr, "iu"),
    ):
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds or array.ndim != 1:
            raise FormatError(
                f"{where}: {name} is {describe_kind(array)}; expected one row of numbers", path
            )
    # scipy does not check this for a matrix without entries, and reads out of bounds.
    if (indptr[1:] < indptr[:-1]).any():
        raise FormatError(
            f"{where}: indptr decreases; expected the start of each row or column", path
        )
    try:
        out = make((data, indices.astype(np.int64), indptr.astype(np.int64)), shape=shape)
        out.check_format(full_check=True)
        entries = out.nnz
        out.sum_duplicates()
    except ValueError as error:
        raise FormatError(
            f"{where}: not a sparse matrix of shape {shape} ({error})", path
        ) from error
    if out.nnz != entries:
        raise FormatError(f"{where}: an entry occurs twice", path)
    if (
        max(*shape, entries) < 2**31
    ):  # the index type that scipy would choose; the range is checked above
        out.indices, out.indptr = out.indices.astype(np.int32), out.indptr.astype(np.int32)
    return out


def as_dofs(given: object, name: str, path: str | Path) -> DofSet:
    """Return DOFs from labels, or from a table of node and direction 1..6, negative if opposite."""
    with locate_errors(path, name):
        if isinstance(given, str):
            return DofSet([given])
        if isinstance(given, list):
            return DofSet(given)
        table = as_integers(given, name, path)
        if table.ndim != 2 or table.shape[1] != 2:
            raise FormatError(
                f"{name}: found numbers of shape {table.shape}; expected labels such as '12:Z', or"
                " an (N, 2) table of node and direction 1..6",
                path,
            )
        axes = np.abs(table[:, 1]) - 1
        if ((axes < 0) | (axes > 5)).any():
            at = int(np.flatnonzero((axes < 0) | (axes > 5))[0])
            raise FormatError(
                f"{name}: row {at + 1} has direction {table[at, 1]}; expected 1..6 for X, Y, Z, RX,"
                " RY, RZ",
                path,
            )
        return DofSet.from_arrays(table[:, 0], axes, np.sign(table[:, 1]))


def as_matrix(given: Any, name: str, path: str | Path) -> Matrix:
    """Return a matrix, as sparse CSR or a two-dimensional array."""
    # Truth values become 0 and 1, and complex numbers without an imaginary part become real.
    if sp.issparse(given):
        out = sp.csr_array(given)
        out.data = _plain_entries(out.data)
        return out
    is_logical = isinstance(given, np.ndarray) and given.dtype.kind == "b"
    array = as_numbers(_plain_entries(given) if is_logical else given, name, path)
    if array.ndim != 2:
        raise FormatError(f"{name}: found shape {array.shape}; expected (N, N)", path)
    return _plain_entries(array)


def _plain_entries(entries: NumberArray) -> NumberArray:
    """Return truth values, and complex entries without an imaginary part, as real numbers."""
    if entries.dtype.kind == "b":
        return entries.astype(np.float64)
    if entries.dtype.kind == "c" and not entries.imag.any():
        return np.ascontiguousarray(entries.real)
    return entries


def as_numbers(given: Any, name: str, path: str | Path) -> NumberArray:
    """Return an item as a number array."""
    if sp.issparse(given):
        return np.asarray(given.toarray())
    if isinstance(given, Unread):
        raise FormatError(given.reason, path)
    if (
        not isinstance(given, np.ndarray | float | int | complex)
        or np.asarray(given).dtype.kind not in "iufc"
    ):
        raise FormatError(f"{name}: found {describe_kind(given)}; expected numbers", path)
    return np.asarray(given)


def as_reals(given: object, name: str, path: str | Path) -> NumberArray:
    """Return an item as an array of real numbers."""
    array = as_numbers(given, name, path)
    if array.dtype.kind == "c":
        raise FormatError(f"{name}: found complex numbers; expected real ones", path)
    return array


def as_integers(given: object, name: str, path: str | Path) -> IntArray:
    """Return an item as an array of integers, from any stored type."""
    array = as_reals(given, name, path)
    if (
        not np.isfinite(array).all()
        or (array != np.round(array)).any()
        or (np.abs(array) > 2**53).any()
    ):
        raise FormatError(f"{name}: expected whole numbers", path)
    return array.astype(np.int64)


def as_vector(given: object, name: str, path: str | Path) -> NumberArray:
    """Return real numbers in one row or column, as one dimension."""
    array = as_reals(given, name, path)
    if array.size != max(array.shape, default=1):
        raise FormatError(f"{name}: found shape {array.shape}; expected one row or column", path)
    return array.reshape(-1)


def as_number(given: object, name: str, path: str | Path) -> float:
    """Return an item as one real number."""
    array = as_reals(given, name, path)
    if array.size != 1:
        raise FormatError(f"{name}: found shape {array.shape}; expected one number", path)
    return float(array.reshape(())[()])


def as_text(given: object, name: str, path: str | Path) -> str:
    """Return an item as one text."""
    if isinstance(given, list) and len(given) <= 1:
        given = given[0] if given else ""
    if not isinstance(given, str):
        raise FormatError(f"{name}: found {describe_kind(given)}; expected a text", path)
    return given


def check_phase(values: NumberArray, real_valued: bool, name: str, path: str | Path) -> None:
    """Refuse real FRFs without `real_valued`, and complex FRFs with it."""
    if not isinstance(real_valued, bool):
        raise OptionError(
            f"real_valued {real_valued!r}: expected True or False", key=("real_valued",)
        )
    if values.dtype.kind == "c":
        if real_valued and values.imag.any():
            raise FormatError(
                f"{name}: holds values with an imaginary part, which contradicts real_valued=True",
                path,
                key=("real_valued",),
            )
    elif not real_valued:
        raise FormatError(
            f"{name}: holds real numbers, which may be magnitudes or decibels; expected complex"
            " ones. If the values are real because their phase is 0 or pi, set real_valued=True",
            path,
            key=("real_valued",),
        )


def describe_kind(given: object) -> str:
    """Describe an item, for messages."""
    if isinstance(given, Mapping):
        return f"a struct with {format_names(given)}"
    if isinstance(given, Unread):
        return "not readable"
    if isinstance(given, np.ndarray):
        return f"{given.dtype} of shape {given.shape}"
    return f"{len(given)} texts" if isinstance(given, list) else f"a {type(given).__name__}"


def format_counts(numbers: Mapping[str, int]) -> str:
    """Format names with their counts, for messages: ``3 coherence, 1 spectrum``."""
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def format_names(items: Items) -> str:
    """Format the available names, for messages."""
    names = sorted(str(n) for n in items)
    return (
        ", ".join(names[:10]) + (f", ... ({len(names)} in all)" if len(names) > 10 else "")
        or "nothing"
    )


def format_key(key: Sequence[str | int]) -> str:
    """Format a key path for messages, such as ``columns.channels[1].real``, counted from 1."""
    parts = (f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key)
    return "".join(parts).removeprefix(".")


#: Exceptions of h5py, numpy, scipy.io and zipfile for damaged files (found by changing bytes of
#: valid files).
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def report_library_errors(path: str | Path, what: str) -> Iterator[None]:
    """Report failures of a library that reads `path`, a `what`, as a `FormatError`."""
    try:
        yield
    except InputError:
        raise
    except FAILURES as error:
        raise damaged(path, what, reason_of(error)) from error


@contextmanager
def guard_reader(path: str | Path, reader: str) -> Iterator[None]:
    """Report unexpected exceptions of a reader as a `FormatError`, as the last resort."""
    # Errors of updyn, and warnings turned into exceptions, pass.
    try:
        yield
    except (UpdynError, Warning):
        raise
    except OSError as error:
        raise unreadable_error(path, error) from error
    except MemoryError as error:
        raise FormatError(f"cannot be read (reader {reader!r}): out of memory", path) from error
    except Exception as error:
        message_lines = str(error).strip().splitlines()
        reason = f": {message_lines[0][:200]}" if message_lines else ""
        raise FormatError(
            f"cannot be read (reader {reader!r}): {type(error).__name__}{reason}", path
        ) from error


@contextmanager
def locate_errors(path: str | Path, item: str = "") -> Iterator[None]:
    """Add the path, and the item, to errors about the content of a file."""
    try:
        yield
    except FormatError:
        raise
    except InputError as error:
        text = f"{item}: {error}" if item else str(error)
        raise FormatError(text, path, key=error.key) from error


def require_file(path: str | Path) -> Path:
    """Return the path of an existing file; raise a FormatError with the nearest name otherwise."""
    path = Path(path)
    if not is_file(path):
        raise FormatError(f"no such file; {suggest_file(path)}", path)
    return path


def is_file(path: str | Path) -> bool:
    """Return whether a file exists; False for an invalid name."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # too long, a null character, a folder without permission
        return False


def is_folder(path: str | Path) -> bool:
    """Return whether a folder exists; False for an invalid name."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def unreadable_error(path: str | Path, error: OSError) -> FormatError:
    """Return the error for a file that the system cannot open or read."""
    return FormatError(f"cannot be read: {error.strerror or error}", path)


def read_utf8(path: str | Path) -> str:
    """Return the text of a file in UTF-8."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"not a text in UTF-8 ({error.reason} at byte {error.start})", path
        ) from error
    except OSError as error:
        raise unreadable_error(path, error) from error


def read_windows_text(path: str | Path) -> str:
    """Return a text in UTF-8, or in Windows-1252 as LabVIEW and Excel write it, with line feeds."""
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise unreadable_error(path, error) from error
    if b"\0" in raw:
        raise FormatError("not a text in UTF-8 or Windows-1252; save it as UTF-8", path)
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding).replace("\r\n", "\n")
        except UnicodeDecodeError as error:
            wrong = error
    raise FormatError(
        f"not a text in UTF-8 or Windows-1252 ({wrong.reason} at byte {wrong.start}); save it as"
        " UTF-8",
        path,
    )


def refuse_repeated_names(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return a JSON object as a dict, or raise a ValueError for repeated names (a pairs hook)."""
    # `json.loads` would keep the last value of a repeated name.
    found: dict[str, object] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{name!r} occurs twice")
        found[name] = value
    return found


def suggest_file(missing: Path) -> str:
    """Return a hint about a missing file: the nearest names in its folder."""
    if len(missing.name) > _LONGEST_NAME:
        return "the name is too long for a file"
    if not is_folder(missing.parent):
        return "its folder does not exist"
    names = [entry.name for entry in missing.parent.iterdir() if entry.is_file()]
    return suggest(missing.name, sorted(names)) if names else "its folder is empty"


def parse_selection(labels: Iterable[str | Dof], side: str, path: str | Path) -> DofSet:
    """Return the DOFs to select as "responses" or "references" (`side`), at least one."""
    with locate_errors(path, side), key_path(side):
        dofs = DofSet(labels)
    if not len(dofs):
        raise FormatError(f"{side}: an empty list; omit it to read all", path, key=(side,))
    return dofs


def check_names(
    found: Collection[str], known: Collection[str], path: str | Path, where: str = ""
) -> None:
    """Refuse unknown names, because a misspelt one would otherwise be ignored silently."""
    for name in found:
        if name not in known:
            raise FormatError(
                f"{where + ': ' if where else ''}unknown name {name!r}; {suggest(name, known)}",
                path,
            )
