"""MKL PARDISO for symmetric matrices, through the ``mkl`` wheel (extra ``updyn[mkl]``).

A pattern is analysed once; only the upper triangle is stored and factorised (L D L^T). Matrix types
6 and -2 and parameters as in the oneMKL PARDISO reference.
"""

from __future__ import annotations

import ctypes
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np

from updyn.arrays import IntArray, NumberArray
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.single import round_to_single, solve_scaled
from updyn.linalg.triangle import upper_triangle

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = ["Pardiso", "library"]

_NAMES = ("libmkl_rt.so.3", "libmkl_rt.so.2", "mkl_rt.3.dll", "mkl_rt.2.dll")
_COMPLEX_SYMMETRIC, _REAL_SYMMETRIC_INDEFINITE = 6, -2
_TYPES = {(False, False): np.complex128, (True, False): np.float64, (True, True): np.float32}
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_ENOUGH_MEMORY = -2
#: Number of entries above which a matrix needs 64-bit indices (oneMKL reference of pardiso_64).
_MOST_ENTRIES = 500_000_000


@cache
def library() -> Any:
    """Return MKL of the wheel installed in this Python environment, or None."""
    # MKL reads this when it makes its threads. They would spin for 0.2 s after every call, on the
    # cores of numpy's BLAS, whose next products then take four times as long (measured, two cores).
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    for folder in (Path(sys.prefix, "lib"), Path(sys.prefix, "Library", "bin")):
        for name in _NAMES:
            if (folder / name).is_file():
                try:
                    return ctypes.CDLL(str(folder / name))
                except OSError:  # a wheel of another platform, or with missing libraries
                    continue
    return None


class Pardiso:
    """Factorisation of one symmetric, sorted pattern with a full diagonal, analysed once."""

    install = "pip install 'updyn[mkl]' (x86_64)"
    has_single = True

    @staticmethod
    def available() -> bool:
        """Return whether the ``mkl`` wheel is installed and can be loaded."""
        return library() is not None

    def __init__(self, pattern: csc_array, *, real: bool = False, single: bool = False) -> None:
        if not pattern.has_canonical_format:
            # It would overwrite other memory.
            raise ValueError("PARDISO needs sorted and unique row indices")
        self._upper, ia = upper_triangle(pattern.indptr, pattern.indices)
        ja = pattern.indices[self._upper]
        if not (np.diff(ia).all() and np.array_equal(ja[ia[:-1]], np.arange(len(ia) - 1))):
            raise RuntimeError("PARDISO needs a full diagonal in the pattern")
        self._kind = _COMPLEX_SYMMETRIC
        if real:
            self._kind = _REAL_SYMMETRIC_INDEFINITE
        # A factor may have more entries than 32-bit indices can count (one with 2,150,435,714 was
        # used); A may not.
        integer = np.dtype(np.int32 if len(ja) < _MOST_ENTRIES else np.int64)
        a: NumberArray = np.ones(len(ja), dtype=_TYPES[real, single])
        iparm = np.zeros(64, dtype=integer)
        iparm[0] = 1  # no defaults: every parameter is set here
        iparm[1] = 2  # nested dissection (METIS)
        iparm[9] = 8  # pivots below 1e-8 are perturbed; `factor` then raises an error
        iparm[17] = -1  # report the entries of the factor
        iparm[20] = 1  # Bunch-Kaufman pivots
        iparm[27] = int(single)
        iparm[34] = 1  # indices from zero
        handle = np.zeros(64, dtype=np.int64)
        self._session = _Session(
            self._kind, handle, iparm, a, ia.astype(integer), ja.astype(integer, copy=False)
        )
        # The library's memory is freed with this object, or with the process.
        self._end = finalize(self, self._session.call, _RELEASE)
        self._end.atexit = False
        self._session.call(_ANALYSE)

    @property
    def peak_bytes(self) -> int:
        """Largest memory of the library with the factor; estimated before `factor`."""
        return self._session.peak_bytes()

    def factor(self, A: csc_array) -> _PardisoFactors:
        """Return the factors of a matrix; those of an earlier call become invalid.

        Raises RuntimeError also for a perturbed pivot or a value beyond the range of the precision.
        """
        session, at = self._session, 0
        for first in range(0, len(self._upper), SPARSE_SOLVER.entries_per_step):
            part = slice(first, first + SPARSE_SOLVER.entries_per_step)
            values = A.data[part][self._upper[part]]
            with np.errstate(over="ignore"):
                session.a[at : at + len(values)] = values
            at += len(values)
        if session.is_single:
            round_to_single(session.a)
        session.call(_FACTOR)
        if session.iparm[13]:
            # A perturbed pivot hides that a matrix is singular.
            raise RuntimeError(f"PARDISO perturbed {session.iparm[13]} pivots")
        negative = None
        if self._kind == _REAL_SYMMETRIC_INDEFINITE:
            negative = int(session.iparm[22])
        return _PardisoFactors(session, negative)

    def release(self) -> None:
        """Free the library's memory; the object cannot be used afterwards."""
        self._end()


@dataclass(frozen=True, slots=True, eq=False)
class _PardisoFactors:
    session: _Session
    negative: int | None

    def __call__(self, B: NumberArray) -> NumberArray:
        if self.session.is_single:
            return solve_scaled(self._solve, B)
        return self._solve(B)

    def _solve(self, B: NumberArray) -> NumberArray:
        b = np.asfortranarray(B, dtype=self.session.a.dtype)
        x = np.empty_like(b)
        if x.size:  # the library rejects zero columns
            self.session.call(_SOLVE, b, x)
        return x


@dataclass(frozen=True, slots=True, eq=False)
class _Session:
    """The handle of the library and its arrays."""

    kind: int
    handle: IntArray
    iparm: NumberArray
    a: NumberArray
    ia: NumberArray
    ja: NumberArray

    @property
    def is_single(self) -> bool:
        """Whether the library works in single precision."""
        return self.a.dtype == np.float32

    def call(self, phase: int, b: NumberArray | None = None, x: NumberArray | None = None) -> None:
        integer: type[ctypes.c_int32 | ctypes.c_int64] = ctypes.c_int32
        run = library().pardiso
        if self.iparm.dtype == np.int64:
            integer = ctypes.c_int64
            run = library().pardiso_64

        def number(value: int) -> Any:
            return ctypes.byref(integer(value))

        def place(array: NumberArray | None) -> ctypes.c_void_p | None:
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
