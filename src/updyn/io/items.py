"""Items of a file (arrays, matrices, texts, DOFs), checked and converted, or refused by name.

The libraries that read archives raise many kinds of exceptions for a damaged file. `library`
catches them at the call into the library and nowhere else, so that a mistake of our own is not
taken for a bad file.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

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
    "check_phase",
    "chosen",
    "compressed",
    "counted",
    "dofs",
    "existing",
    "guarded",
    "is_file",
    "is_folder",
    "kind_of",
    "known_only",
    "library",
    "listed",
    "matrix",
    "nearest",
    "number",
    "numbers",
    "once",
    "placed",
    "real",
    "text",
    "unreadable",
    "utf8_text",
    "vector",
    "whole",
    "windows_text",
]

Items = Mapping[str, Any]
#: Longest name of a file.
_LONGEST_NAME = 255


def compressed(
    make: Any,
    data: NDArray[Any],
    indices: NDArray[Any],
    indptr: NDArray[Any],
    shape: tuple[int, int],
    where: str,
    path: str | Path,
) -> Matrix:
    """Return a sparse matrix from its three arrays, after checking that they fit each other.

    Parameters
    ----------
    make : type
        ``scipy.sparse.csr_array`` or ``csc_array``.
    data, indices, indptr : ndarray, one-dimensional
        The entries, their columns (CSR) or rows (CSC), and where each row (column) starts.
    shape : (int, int)
        Shape of the matrix.
    where : str
        Which matrix, for the message.
    path : path
        The file, for the message.

    Raises
    ------
    FormatError
        If the arrays are not of numbers, do not fit each other or the shape, or an entry stands
        twice.
    """
    for name, array, kinds in (
        ("data", data, "biufc"),
        ("indices", indices, "iu"),
        ("indptr", indptr, "iu"),
    ):
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds or array.ndim != 1:
            raise FormatError(
                f"{where}: {name} is {kind_of(array)}; expected one row of numbers", path
            )
    # Of a matrix without entries scipy does not check it, and follows it anywhere.
    if (indptr[1:] < indptr[:-1]).any():
        raise FormatError(f"{where}: indptr falls; expected where each row or column starts", path)
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
        raise FormatError(f"{where}: an entry stands twice", path)
    if (
        max(*shape, entries) < 2**31
    ):  # the index type that scipy itself chooses; checked above with room to spare
        out.indices, out.indptr = out.indices.astype(np.int32), out.indptr.astype(np.int32)
    return out


def dofs(given: Any, name: str, path: str | Path) -> DofSet:
    """Return DOFs from labels, or from a table of node and direction 1..6, negative if opposite.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    with placed(path, name):
        if isinstance(given, str):
            return DofSet([given])
        if isinstance(given, list):
            return DofSet(given)
        table = whole(given, name, path)
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


def matrix(given: Any, name: str, path: str | Path) -> Matrix:
    """Return a matrix, sparse as CSR or a two-dimensional array.

    Truth values are 0 and 1, and complex numbers without an imaginary part are real.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    if sp.issparse(given):
        out = sp.csr_array(given)
        out.data = _plain_entries(out.data)
        return out
    is_logical = isinstance(given, np.ndarray) and given.dtype.kind == "b"
    array = numbers(_plain_entries(given) if is_logical else given, name, path)
    if array.ndim != 2:
        raise FormatError(f"{name}: found shape {array.shape}; expected (N, N)", path)
    return _plain_entries(array)


def _plain_entries(entries: NDArray[Any]) -> NDArray[Any]:
    """Return entries as real numbers if they are truth values, or have no imaginary part."""
    if entries.dtype.kind == "b":
        return entries.astype(np.float64)
    if entries.dtype.kind == "c" and not entries.imag.any():
        return np.ascontiguousarray(entries.real)
    return entries


def numbers(given: Any, name: str, path: str | Path) -> NDArray[Any]:
    """Return a number array.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    if sp.issparse(given):
        return np.asarray(given.toarray())
    if isinstance(given, Unread):
        raise FormatError(given.reason, path)
    if (
        not isinstance(given, np.ndarray | float | int | complex)
        or np.asarray(given).dtype.kind not in "iufc"
    ):
        raise FormatError(f"{name}: found {kind_of(given)}; expected numbers", path)
    return np.asarray(given)


def real(given: Any, name: str, path: str | Path) -> NDArray[Any]:
    """Return an array of real numbers.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    array = numbers(given, name, path)
    if array.dtype.kind == "c":
        raise FormatError(f"{name}: found complex numbers; expected real ones", path)
    return array


def whole(given: Any, name: str, path: str | Path) -> NDArray[np.int64]:
    """Return an array of whole numbers, from whichever type they are stored in.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    array = real(given, name, path)
    if (
        not np.isfinite(array).all()
        or (array != np.round(array)).any()
        or (np.abs(array) > 2**53).any()
    ):
        raise FormatError(f"{name}: expected whole numbers", path)
    return array.astype(np.int64)


def vector(given: Any, name: str, path: str | Path) -> NDArray[Any]:
    """Return real numbers in one row or column, as one dimension.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    array = real(given, name, path)
    if array.size != max(array.shape, default=1):
        raise FormatError(f"{name}: found shape {array.shape}; expected one row or column", path)
    return array.reshape(-1)


def number(given: Any, name: str, path: str | Path) -> float:
    """Return one real number.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    array = real(given, name, path)
    if array.size != 1:
        raise FormatError(f"{name}: found shape {array.shape}; expected one number", path)
    return float(array.reshape(())[()])


def text(given: Any, name: str, path: str | Path) -> str:
    """Return one text.

    Raises
    ------
    FormatError
        If the item called `name` is not that.
    """
    if isinstance(given, list) and len(given) <= 1:
        given = given[0] if given else ""
    if not isinstance(given, str):
        raise FormatError(f"{name}: found {kind_of(given)}; expected a text", path)
    return given


def check_phase(values: NDArray[Any], real_valued: bool, name: str, path: str | Path) -> None:
    """Refuse real FRFs that are not stated to be real-valued, and complex ones that are.

    Parameters
    ----------
    values : ndarray
        The FRFs of a file.
    real_valued : bool
        Whether the user states that their phase is 0 or pi.
    name : str
        Name of the array, for messages.
    path : path
        The file, for messages.

    Raises
    ------
    FormatError
        If they are real without the statement, or contradict it.
    OptionError
        If `real_valued` is not a bool.
    """
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
            f"{name}: holds real numbers, and magnitudes and decibels are no FRFs; expected complex"
            " ones. If the values are real because their phase is 0 or pi, state real_valued=True",
            path,
            key=("real_valued",),
        )


def kind_of(given: Any) -> str:
    """Say what an item is, for a message."""
    if isinstance(given, Mapping):
        return f"a struct with {listed(given)}"
    if isinstance(given, Unread):
        return "not readable"
    if isinstance(given, np.ndarray):
        return f"{given.dtype} of shape {given.shape}"
    return f"{len(given)} texts" if isinstance(given, list) else f"a {type(given).__name__}"


def counted(numbers: Mapping[str, int]) -> str:
    """Return how often there is what, for a message: ``3 coherence, 1 spectrum``."""
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def listed(items: Items) -> str:
    """Say which names there are, for a message."""
    names = sorted(str(n) for n in items)
    return (
        ", ".join(names[:10]) + (f", ... ({len(names)} in all)" if len(names) > 10 else "")
        or "nothing"
    )


#: What h5py, numpy, scipy.io and zipfile raise for damaged files (found by flipping bytes in good
#: ones).
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
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
def library(path: str | Path, what: str) -> Iterator[None]:
    """Report any failure of a library that reads `path`, a `what`, as a `FormatError`."""
    try:
        yield
    except InputError:
        raise
    except FAILURES as error:
        raise damaged(path, what, reason_of(error)) from error


@contextmanager
def guarded(path: str | Path, reader: str) -> Iterator[None]:
    """Report whatever else goes wrong in a reader as a `FormatError`: the last net below it.

    Parameters
    ----------
    path : path
        The file.
    reader : str
        Name of its format, for the message.

    Yields
    ------
    None

    Raises
    ------
    FormatError
        For any exception that is not ours. Warnings that a caller turns into exceptions pass.
    """
    try:
        yield
    except (UpdynError, Warning):
        raise
    except OSError as error:
        raise unreadable(path, error) from error
    except MemoryError as error:
        raise FormatError(f"cannot be read (reader {reader!r}): out of memory", path) from error
    except Exception as error:
        said = str(error).strip().splitlines()
        reason = f": {said[0][:200]}" if said else ""
        raise FormatError(
            f"cannot be read (reader {reader!r}): {type(error).__name__}{reason}", path
        ) from error


@contextmanager
def placed(path: str | Path, item: str = "") -> Iterator[None]:
    """Give an error about what a file holds the path, and the item, that it belongs to."""
    try:
        yield
    except FormatError:
        raise
    except InputError as error:
        text = f"{item}: {error}" if item else str(error)
        raise FormatError(text, path, key=error.key) from error


def existing(path: str | Path) -> Path:
    """Return the path of a file that is there.

    Raises
    ------
    FormatError
        If it is not; the nearest name beside it is given.
    """
    path = Path(path)
    if not is_file(path):
        raise FormatError(f"no such file; {nearest(path)}", path)
    return path


def is_file(path: str | Path) -> bool:
    """Return whether there is such a file; of a name that no file can have, that there is none."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # too long, a null character, a folder that cannot be entered
        return False


def is_folder(path: str | Path) -> bool:
    """Return whether there is such a folder; of a name that none can have, that there is none."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def unreadable(path: str | Path, error: OSError) -> FormatError:
    """Return the error to raise where the system refuses to open or to read a file."""
    return FormatError(f"cannot be read: {error.strerror or error}", path)


def utf8_text(path: str | Path) -> str:
    """Return the text of a file.

    Raises
    ------
    FormatError
        If it cannot be read, or is not in UTF-8.
    """
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"not a text in UTF-8 ({error.reason} at byte {error.start})", path
        ) from error
    except OSError as error:
        raise unreadable(path, error) from error


def windows_text(path: str | Path) -> str:
    """Return the text of a file in UTF-8, or in Windows-1252 as LabVIEW and Excel write it.

    Lines end with a line feed.

    Raises
    ------
    FormatError
        If it cannot be read, or is in neither encoding.
    """
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from error
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


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the names and values of a JSON object: the ``object_pairs_hook`` of `json.loads`.

    Raises
    ------
    ValueError
        If a name stands twice, of which JSON would keep the last.
    """
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{name!r} stands twice")
        found[name] = value
    return found


def nearest(missing: Path) -> str:
    """Return what to say of a file that is not there: the nearest names in its folder."""
    if len(missing.name) > _LONGEST_NAME:
        return "there cannot be one of so long a name"
    if not is_folder(missing.parent):
        return "its folder does not exist"
    names = [entry.name for entry in missing.parent.iterdir() if entry.is_file()]
    return suggest(missing.name, sorted(names)) if names else "its folder is empty"


def chosen(labels: Iterable[str | Dof], side: str, path: str | Path) -> DofSet:
    """Return the DOFs to select of a side, "responses" or "references", at least one.

    Raises
    ------
    FormatError
        If there is none, one cannot be read or stands twice.
    """
    with placed(path, side), key_path(side):
        dofs = DofSet(labels)
    if not len(dofs):
        raise FormatError(f"{side}: an empty list; leave it out to read all", path, key=(side,))
    return dofs


def known_only(
    found: Collection[str], known: Collection[str], path: str | Path, where: str = ""
) -> None:
    """Refuse names that mean nothing here: a misspelt one would be left out without a word.

    Raises
    ------
    FormatError
        If a name of `found` is not in `known`; the nearest known ones are given.
    """
    for name in found:
        if name not in known:
            raise FormatError(
                f"{where + ': ' if where else ''}unknown name {name!r}; {suggest(name, known)}",
                path,
            )
