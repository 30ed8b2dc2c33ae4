"""MKL PARDISO for symmetric matrices, through the ``mkl`` wheel (extra ``updyn[mkl]``).

The symbolic analysis of a pattern is done once and serves every line and every iteration after it;
only the upper triangle is stored and factorised (L D L^T). Matrix types 6 and -2 and parameters as
in the oneMKL PARDISO reference.
"""

from __future__ import annotations

import ctypes
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from updyn.linalg.single import in_range, solved
from updyn.linalg.triangle import upper_triangle

__all__ = ["Pardiso", "library"]

_NAMES = ("libmkl_rt.so.3", "libmkl_rt.so.2", "mkl_rt.3.dll", "mkl_rt.2.dll")
_COMPLEX_SYMMETRIC, _REAL_SYMMETRIC_INDEFINITE = 6, -2
_TYPES: Any = {(False, False): np.complex128, (True, False): np.float64, (True, True): np.float32}
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_ENOUGH_MEMORY = -2
#: Above, a matrix needs indices of 64 bits (oneMKL reference of pardiso_64).
_MOST_ENTRIES = 500_000_000
#: Entries that are worked on at a time, as a copy of all would cost memory.
_BLOCK = 2**18


@cache
def library() -> Any:
    """Return MKL of the wheel that is installed beside this Python, or None."""
    # Read when its threads are made. They would spin for 0.2 s after every call, on the cores that
    # numpy's BLAS needs for the products that follow: four times as long (measured, two cores).
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    for folder in (Path(sys.prefix, "lib"), Path(sys.prefix, "Library", "bin")):
        for name in _NAMES:
            if (folder / name).is_file():
                try:
                    return ctypes.CDLL(str(folder / name))
                except OSError:  # a wheel of another platform, or without its companions
                    continue
    return None


class Pardiso:
    """One pattern, analysed once.

    Parameters
    ----------
    pattern : sparse CSC, shape (n, n)
        A matrix of the pattern: symmetric, sorted, with a full diagonal.
    real : bool
        Matrices are real, definite or not, instead of complex.
    single : bool
        They are factorised in single precision.

    Raises
    ------
    RuntimeError
        If the library reports an error, or the diagonal is not full.
    MemoryError
        If there is not enough memory.
    """

    install = "pip install 'updyn[mkl]' (x86_64)"
    has_single = True

    @staticmethod
    def available() -> bool:
        """Return whether the ``mkl`` wheel is installed and can be loaded."""
        return library() is not None

    def __init__(self, pattern: Any, *, real: bool = False, single: bool = False) -> None:
        if not pattern.has_canonical_format:
            # It would overwrite memory that is not its own.
            raise ValueError("PARDISO needs row indices that are sorted, each once")
        self._upper, ia = upper_triangle(pattern.indptr, pattern.indices)
        ja = pattern.indices[self._upper]
        if not (np.diff(ia).all() and np.array_equal(ja[ia[:-1]], np.arange(len(ia) - 1))):
            raise RuntimeError("PARDISO needs a full diagonal in the pattern")
        self._kind = _COMPLEX_SYMMETRIC
        if real:
            self._kind = _REAL_SYMMETRIC_INDEFINITE
        # A factor may well have more entries than 32 bits can count (one of 2,150,435,714 was
        # solved with); A may not.
        integer: Any = np.int64
        if len(ja) < _MOST_ENTRIES:
            integer = np.int32
        a = np.ones(len(ja), dtype=_TYPES[real, single])
        iparm = np.zeros(64, dtype=integer)
        iparm[0] = 1  # no defaults: every parameter is set here
        iparm[1] = 2  # nested dissection (METIS)
        iparm[9] = 8  # pivots below 1e-8 are perturbed, which is not accepted
        iparm[17] = -1  # report the entries of the factor
        iparm[20] = 1  # Bunch-Kaufman pivots
        iparm[27] = int(single)
        iparm[34] = 1  # indices from zero
        handle = np.zeros(64, dtype=np.int64)
        self._session = _Session(
            self._kind, handle, iparm, a, ia.astype(integer), ja.astype(integer, copy=False)
        )
        # The library's memory goes with this object; at the interpreter's end with the process.
        self._end = finalize(self, self._session.call, _RELEASE)
        self._end.atexit = False
        self._session.call(_ANALYSE)

    @property
    def peak_bytes(self) -> int:
        """Largest memory of the library, the factor included; estimated before `factor`."""
        return self._session.peak_bytes()

    def factor(self, A: Any) -> _LDL:
        """Factorise a matrix of the pattern; what an earlier call returned is no longer valid.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), symmetric, of the kind analysed for
            Matrix.

        Returns
        -------
        callable
            Solves for right-hand sides, shape (n, r).

        Raises
        ------
        RuntimeError
            If the library reports an error, or had to perturb a pivot, or a value is beyond the
            range of the precision.
        MemoryError
            If there is not enough memory.
        """
        session, at = self._session, 0
        for first in range(0, len(self._upper), _BLOCK):
            part = slice(first, first + _BLOCK)
            values = A.data[part][self._upper[part]]
            with np.errstate(over="ignore"):
                session.a[at : at + len(values)] = values
            at += len(values)
        if session.is_single:
            in_range(session.a)
        session.call(_FACTOR)
        if session.iparm[13]:
            # A perturbed pivot makes a singular matrix look like a regular one.
            raise RuntimeError(f"PARDISO perturbed {session.iparm[13]} pivots")
        negative = None
        if self._kind == _REAL_SYMMETRIC_INDEFINITE:
            negative = int(session.iparm[22])
        return _LDL(session, negative)

    def release(self) -> None:
        """Give the library's memory back; the object is of no more use."""
        self._end()


@dataclass(frozen=True, slots=True, eq=False)
class _LDL:
    session: _Session
    negative: int | None

    def __call__(self, B: NDArray[Any]) -> NDArray[Any]:
        if self.session.is_single:
            return solved(self._solved, B)
        return self._solved(B)

    def _solved(self, B: NDArray[Any]) -> NDArray[Any]:
        b = np.asfortranarray(B, dtype=self.session.a.dtype)
        x = np.empty_like(b)
        if x.size:  # no column at all is an error to the library
            self.session.call(_SOLVE, b, x)
        return x


@dataclass(frozen=True, slots=True, eq=False)
class _Session:
    """The library's handle and the arrays that it reads."""

    kind: int
    handle: NDArray[np.int64]
    iparm: NDArray[Any]
    a: NDArray[Any]
    ia: NDArray[Any]
    ja: NDArray[Any]

    @property
    def is_single(self) -> bool:
        """Whether the library works in single precision."""
        return self.a.dtype == np.float32

    def call(
        self, phase: int, b: NDArray[Any] | None = None, x: NDArray[Any] | None = None
    ) -> None:
        integer: Any = ctypes.c_int32
        run = library().pardiso
        if self.iparm.dtype == np.int64:
            integer = ctypes.c_int64
            run = library().pardiso_64

        def number(value: int) -> Any:
            return ctypes.byref(integer(value))

        def place(array: NDArray[Any] | None) -> Any:
            if array is None:
                return None
            return ctypes.c_void_p(array.ctypes.data)

        error = integer(0)
        n_columns = 1
        if b is not None:
            n_columns = b.shape[1]
        run(
            place(self.handle), number(1), number(1), number(self.kind), number(phase),
            number(len(self.ia) - 1), place(self.a), place(self.ia), place(self.ja), None,
            number(n_columns), place(self.iparm), number(0), place(b), place(x),
            ctypes.byref(error),
        )  # fmt: skip
        if error.value == _NOT_ENOUGH_MEMORY:
            raise MemoryError(f"PARDISO needs {self.peak_bytes() / 1e9:.1f} GB")
        if error.value:
            raise RuntimeError(f"PARDISO error {error.value} in phase {phase}")

    def peak_bytes(self) -> int:
        analysis, kept, factor = map(int, self.iparm[14:17])  # in kilobytes
        return 1024 * max(analysis, kept + factor)
