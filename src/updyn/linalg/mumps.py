"""MUMPS through python-mumps (extra ``updyn[mumps]``), built against an installed MUMPS.

The package pymumps has the same module name but is another package.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray

__all__ = ["Mumps"]

_PACKAGE = "mumps"
#: MUMPS users' guide, section "Error and warning diagnostics".
_NOT_ENOUGH_MEMORY = (-5, -7, -13)


@cache
def _package() -> Any:
    """Return the package, or None if it is missing, cannot be loaded, or is pymumps."""
    try:
        found = importlib.import_module(_PACKAGE)
    except (ImportError, OSError):  # the library that it was built against may be missing
        return None
    return found if hasattr(found, "Context") else None


class Mumps:
    """Factorisation of one pattern, analysed once (L D L^T with two by two pivots, SYM = 2)."""

    install = (
        "install the library MUMPS (Debian: libmumps-seq-dev), then pip install 'updyn[mumps]'"
    )

    @staticmethod
    def available() -> bool:
        """Return whether python-mumps is installed and can be loaded."""
        return _package() is not None

    def __init__(self, pattern: sp.csc_array, *, real: bool = False) -> None:
        column = np.repeat(np.arange(pattern.shape[0], dtype=np.int32), np.diff(pattern.indptr))
        self._upper = pattern.indices <= column
        values = np.ones(int(self._upper.sum()), dtype=np.float64 if real else np.complex128)
        triangle = sp.coo_array(
            (values, (pattern.indices[self._upper], column[self._upper])), shape=pattern.shape
        )
        self._real = real
        self._context: Any = _package().Context()
        self._context.set_matrix(triangle, symmetric=True)
        # The analysis uses the pattern only, not the values.
        self._context.mumps_instance.icntl[6] = 0
        self._run(self._context.analyze, ordering="metis")

    @property
    def peak_bytes(self) -> int:
        """Memory of the library with the factor; estimated before the first `factor`."""
        megabytes = self._context.analysis_stats.est_mem_incore
        if self._context.factored:
            megabytes = self._context.factor_stats.memory
        return int(megabytes) * 10**6

    def factor(self, A: sp.csc_array) -> _MumpsFactors:
        """Return the factors of a matrix; those of an earlier call become invalid."""
        np.compress(self._upper, A.data, out=self._context.data)  # read by the library
        self._run(self._context.factor, reuse_analysis=True)
        negative = None
        if self._real:
            negative = int(self._context.mumps_instance.infog[12])
        return _MumpsFactors(self._context, negative)

    def release(self) -> None:
        """Free the library's memory; the object cannot be used afterwards."""
        self._context.mumps_instance = None

    @staticmethod
    def _run(step: Callable[..., None], **options: object) -> None:
        try:
            step(**options)
        except RuntimeError as error:
            if getattr(error, "error", 0) in _NOT_ENOUGH_MEMORY:
                raise MemoryError(str(error)) from error
            raise


@dataclass(frozen=True, slots=True, eq=False)
class _MumpsFactors:
    context: Any
    negative: int | None

    def __call__(self, B: NumberArray) -> NumberArray:
        return np.asarray(self.context.solve(np.array(B, order="F"), overwrite_b=True))
