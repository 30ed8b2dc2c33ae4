"""MKL PARDISO for complex symmetric matrices, through the ``mkl`` wheel (extra ``updyn[mkl]``).

The symbolic analysis of a pattern is done once and serves every line and every iteration after it; only the upper
triangle is stored and factorised (L D L^T). Matrix type 6 and parameters as in the oneMKL PARDISO reference.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pardiso", "available"]

_NAMES = ("libmkl_rt.so.3", "libmkl_rt.so.2", "mkl_rt.3.dll", "mkl_rt.2.dll")
_COMPLEX_SYMMETRIC = 6
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1


@cache
def _library() -> Any:
    """Return the library of the wheel that is installed beside this Python, or None."""
    for folder in (Path(sys.prefix, "lib"), Path(sys.prefix, "Library", "bin")):
        for name in _NAMES:
            if (folder / name).is_file():
                try:
                    return ctypes.CDLL(str(folder / name))
                except OSError:  # a wheel of another platform, or without its companions
                    continue
    return None


def available() -> bool:
    """Return whether the ``mkl`` wheel is installed and can be loaded."""
    return _library() is not None


class Pardiso:
    """One pattern, analysed once.

    Parameters
    ----------
    pattern : sparse CSC, shape (n, n)
        A matrix of the pattern: symmetric, sorted, with a full diagonal.

    Raises
    ------
    RuntimeError
        If the library reports an error.
    """

    def __init__(self, pattern: Any) -> None:
        n = pattern.shape[0]
        columns = np.repeat(np.arange(n), np.diff(pattern.indptr))
        # CSC of a symmetric matrix is its CSR: rows of the upper triangle are columns of the lower one.
        self._upper = np.flatnonzero(pattern.indices >= columns)
        self._ja = np.ascontiguousarray(pattern.indices[self._upper], dtype=np.int32)
        self._ia = np.zeros(n + 1, dtype=np.int32)
        np.cumsum(np.bincount(columns[self._upper], minlength=n), out=self._ia[1:])
        self._a = np.ones(len(self._ja), dtype=np.complex128)
        self._iparm = np.zeros(64, dtype=np.int32)
        self._iparm[0] = 1  # no defaults: every parameter is set here
        self._iparm[1] = 2  # nested dissection (METIS)
        self._iparm[9] = 8  # pivots below 1e-8 are perturbed, which is not accepted
        self._iparm[20] = 1  # Bunch-Kaufman pivots
        self._iparm[34] = 1  # indices from zero
        handle = np.zeros(64, dtype=np.int64)
        self._call = partial(_call, handle, self._iparm, n, self._a, self._ia, self._ja)
        self._call(_ANALYSE)
        # The library's memory goes with this object; at the interpreter's end with the process.
        finalize(self, self._call, _RELEASE).atexit = False

    def factor(self, A: Any) -> Callable[[NDArray[np.complex128]], NDArray[np.complex128]]:
        """Factorise a matrix of the pattern; what an earlier call returned is no longer valid.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), complex symmetric
            Matrix.

        Returns
        -------
        callable
            Solves for right-hand sides, shape (n, r).

        Raises
        ------
        RuntimeError
            If the library reports an error, or had to perturb a pivot.
        """
        np.take(A.data, self._upper, out=self._a)
        self._call(_FACTOR)
        if self._iparm[13]:
            # A perturbed pivot makes a singular matrix look like a regular one.
            raise RuntimeError(f"PARDISO perturbed {self._iparm[13]} pivots")
        return self._solve

    def _solve(self, B: NDArray[np.complex128]) -> NDArray[np.complex128]:
        b = np.asfortranarray(B, dtype=np.complex128)
        x = np.empty_like(b)
        self._call(_SOLVE, b, x)
        return x


def _call(
    handle: NDArray[np.int64],
    iparm: NDArray[np.int32],
    n: int,
    a: NDArray[np.complex128],
    ia: NDArray[np.int32],
    ja: NDArray[np.int32],
    phase: int,
    b: NDArray[np.complex128] | None = None,
    x: NDArray[np.complex128] | None = None,
) -> None:
    def number(value: int) -> Any:
        return ctypes.byref(ctypes.c_int32(value))

    def place(array: NDArray[Any] | None) -> Any:
        return None if array is None else ctypes.c_void_p(array.ctypes.data)

    error = ctypes.c_int32(0)
    _library().pardiso(
        place(handle), number(1), number(1), number(_COMPLEX_SYMMETRIC), number(phase), number(n),
        place(a), place(ia), place(ja), None, number(1 if b is None else b.shape[1]), place(iparm), number(0),
        place(b), place(x), ctypes.byref(error),
    )  # fmt: skip
    if error.value:
        raise RuntimeError(f"PARDISO error {error.value} in phase {phase}")
