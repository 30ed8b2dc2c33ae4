"""cuDSS for symmetric matrices on a graphics card, through nvmath-python (extra ``updyn[cuda]``).

The pattern is analysed once and stays on the card. Only the upper triangle is stored (L D L^T).
Phases, matrix types and parameters as in the cuDSS reference, version 0.8.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import NumberArray, RealArray
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.solver import unit_scale
from updyn.linalg.triangle import upper_triangle

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = ["Cudss"]

#: Version of cuDSS, on which the parameter numbers depend; that of nvmath-python 1.0.
_VERSION = (0, 8)
#: Library for threads in the ordering; part of cuDSS.
_THREADS = "libcudss_mtlayer_gomp.so.0"


@cache
def _libraries() -> Any:
    """Return the bindings of cuDSS and CUDA; None if they, or a card, are missing."""
    try:
        cudss = importlib.import_module("nvmath.bindings.cudss")
        cuda = importlib.import_module("cuda.bindings.runtime")
        version = (cudss.get_property(0), cudss.get_property(1))
    except (ImportError, OSError, RuntimeError):  # the bindings may lack their libraries
        return None
    error, cards = cuda.cudaGetDeviceCount()
    if error or not cards or version != _VERSION:
        return None
    return SimpleNamespace(cudss=cudss, cuda=cuda)


class Cudss:
    """Factorisation of one pattern, analysed once.

    Rows and columns are scaled, which makes the limit of a small pivot independent of units.
    """

    install = "pip install 'updyn[cuda]' (a card of NVIDIA with a driver for CUDA 13)"

    @staticmethod
    def available() -> bool:
        """Return whether the bindings, cuDSS and a card are available."""
        return _libraries() is not None

    def __init__(self, pattern: csc_array, *, real: bool = False) -> None:
        self._kind: np.dtype[np.inexact] = np.dtype(np.float64 if real else np.complex128)
        self._upper, begin = upper_triangle(pattern.indptr, pattern.indices)
        self._column = pattern.indices[self._upper].astype(np.int32)
        self._lengths = np.diff(begin)
        with ExitStack() as stack:
            self._card = _Card.connect(stack)
            self._values = self._card.room(stack, len(self._column) * self._kind.itemsize)
            self._matrix = self._card.sparse(
                stack, begin.astype(np.int32), self._column, self._values, self._kind
            )
            # Before the first solve, the solution is a placeholder.
            self._none = self._card.dense(stack, np.zeros((len(self._lengths), 1), self._kind))[0]
            self._card.run("ANALYSIS", self._matrix, self._none, self._none)
            # The card's memory is freed with this object, or with the process.
            self._end = finalize(self, stack.pop_all().close)
            self._end.atexit = False

    @property
    def peak_bytes(self) -> int:
        """Largest memory on the card with the factor; estimated before `factor`."""
        return int(self._card.query("MEMORY_ESTIMATES", np.int64, 16)[1])

    def factor(self, A: csc_array) -> _CudssFactors:
        """Return the factors of a matrix; those of an earlier call become invalid.

        Raises RuntimeError also for a perturbed pivot, MemoryError if the card has too little
        memory.
        """
        scale = 1.0 / unit_scale(A.diagonal())
        values = A.data[self._upper].astype(self._kind, copy=False)
        values *= scale[self._column]
        values *= np.repeat(scale, self._lengths)
        self._card.upload(self._values, values)
        self._card.run("FACTORIZATION", self._matrix, self._none, self._none)
        perturbed = int(self._card.query("NPIVOTS", np.int32, 1)[0])
        if perturbed:
            # A perturbed pivot hides that a matrix is singular.
            raise RuntimeError(f"cuDSS perturbed {perturbed} pivots")
        negative = None
        if self._kind == np.float64:
            negative = int(self._card.query("INERTIA", np.int32, 2)[1])
        return _CudssFactors(self._card, self._matrix, scale, self._kind, negative)

    def release(self) -> None:
        """Free the card's memory; the object cannot be used afterwards."""
        self._end()


@dataclass(frozen=True, slots=True, eq=False)
class _CudssFactors:
    card: _Card
    matrix: int
    scale: RealArray
    kind: np.dtype[np.inexact]
    negative: int | None

    def __call__(self, B: NumberArray) -> NumberArray:
        x = np.empty(B.shape, dtype=self.kind, order="F")
        if not x.size:
            return x
        np.multiply(B, self.scale[:, None], out=x)
        with ExitStack() as stack:
            load, _ = self.card.dense(stack, x)
            solution, place = self.card.dense(stack, x)
            self.card.run("SOLVE", self.matrix, solution, load)
            self.card.download(x, place)
        x *= self.scale[:, None]
        return x


@dataclass(frozen=True, slots=True, eq=False)
class _Card:
    """A session of cuDSS, whose objects live as long as the given exit stack."""

    cudss: ModuleType
    cuda: ModuleType
    handle: int
    config: int
    data: int

    @classmethod
    def connect(cls, stack: ExitStack) -> _Card:
        found = _libraries()
        cudss = found.cudss
        with _convert_errors(cudss):
            handle = cudss.create()
            stack.callback(cudss.destroy, handle)
            config = cudss.config_create()
            stack.callback(cudss.config_destroy, config)
            data = cudss.data_create(handle)
            stack.callback(cudss.data_destroy, handle, data)
            threads = _thread_library()
            if threads is not None:
                cudss.set_threading_layer(handle, threads)
        made = cls(cudss, found.cuda, handle, config, data)
        made.set("PIVOT_EPSILON", np.float64, SPARSE_SOLVER.smallest_pivot)
        return made

    def set(self, name: str, kind: type, value: float) -> None:
        values: NumberArray = np.array([value], dtype=kind)
        parameter = self.cudss.ConfigParam[name]
        with _convert_errors(self.cudss):
            self.cudss.config_set(self.config, parameter, values.ctypes.data, values.nbytes)

    def query(self, name: str, kind: type, n: int) -> NumberArray:
        """Return a result of the last phase."""
        values: NumberArray = np.zeros(n, dtype=kind)
        written = np.zeros(1, dtype=np.uint64)
        with _convert_errors(self.cudss):
            self.cudss.data_get(
                self.handle, self.data, self.cudss.DataParam[name],
                values.ctypes.data, values.nbytes, written.ctypes.data,
            )  # fmt: skip
        return values

    def room(self, stack: ExitStack, n_bytes: int) -> int:
        """Return the address of allocated memory of the card."""
        place = self._check_code(self.cuda.cudaMalloc(n_bytes))
        stack.callback(self.cuda.cudaFree, place)
        return int(place)

    def upload(self, place: int, array: NumberArray) -> None:
        to_card = self.cuda.cudaMemcpyKind.cudaMemcpyHostToDevice
        self._check_code(self.cuda.cudaMemcpy(place, array.ctypes.data, array.nbytes, to_card))

    def download(self, array: NumberArray, place: int) -> None:
        to_host = self.cuda.cudaMemcpyKind.cudaMemcpyDeviceToHost
        self._check_code(self.cuda.cudaMemcpy(array.ctypes.data, place, array.nbytes, to_host))

    def sparse(
        self,
        stack: ExitStack,
        begin: NDArray[np.int32],
        column: NDArray[np.int32],
        values: int,
        kind: np.dtype[np.inexact],
    ) -> int:
        """Return an upper triangle, shape (n, n), with values on the card."""
        places = [self.room(stack, array.nbytes) for array in (begin, column)]
        for place, array in zip(places, (begin, column), strict=True):
            self.upload(place, array)
        n, cudss = len(begin) - 1, self.cudss
        index = cudss.DataType.R_32I
        with _convert_errors(cudss):
            made = cudss.matrix_create_csr(
                n, n, len(column), places[0], 0, places[1], values, index, index,
                self._value_type(kind), cudss.MatrixType.SYMMETRIC, cudss.MatrixViewType.UPPER,
                cudss.IndexBase.ZERO,
            )  # fmt: skip
        stack.callback(cudss.matrix_destroy, made)
        return int(made)

    def dense(self, stack: ExitStack, array: NumberArray) -> tuple[int, int]:
        """Return a copy of an array on the card, shape (n, r), and the address of its values."""
        place, cudss = self.room(stack, array.nbytes), self.cudss
        self.upload(place, array)
        n, r = array.shape
        with _convert_errors(cudss):
            made = cudss.matrix_create_dn(
                n, r, n, place, self._value_type(array.dtype), cudss.Layout.COL_MAJOR
            )
        stack.callback(cudss.matrix_destroy, made)
        return int(made), place

    def run(self, phase: str, matrix: int, solution: int, load: int) -> None:
        """Execute a phase and wait for its end."""
        with _convert_errors(self.cudss, phase):
            self.cudss.execute(
                self.handle, self.cudss.Phase[phase], self.config, self.data, matrix, solution, load
            )
        self._check_code(self.cuda.cudaDeviceSynchronize())
        error = int(self.query("INFO", np.int32, 1)[0])
        if error:
            raise RuntimeError(f"cuDSS error {error} in phase {phase}")

    def _value_type(self, kind: np.dtype[np.inexact]) -> Any:
        types = self.cudss.DataType
        if kind == np.float64:
            return types.R_64F
        return types.C_64F

    def _check_code(self, answer: tuple[Any, ...]) -> Any:
        """Return the results of a CUDA function after a check of its error code."""
        error, *values = answer
        if error == self.cuda.cudaError_t.cudaErrorMemoryAllocation:
            raise MemoryError("of the graphics card")
        if error:
            raise RuntimeError(f"CUDA: {error.name}")
        return values[0] if values else None


@contextmanager
def _convert_errors(cudss: ModuleType, phase: str = "") -> Iterator[None]:
    """Convert errors of the library to the types of the protocol."""
    try:
        yield
    except cudss.cuDSSError as error:
        if error.status == cudss.Status.ALLOC_FAILED:
            raise MemoryError("of the graphics card") from error
        where = f" in phase {phase}" if phase else ""
        raise RuntimeError(f"cuDSS: {error}{where}") from error


def _thread_library() -> str | None:
    """Return the library of cuDSS for threads in the ordering, if installed."""
    pathfinder = importlib.import_module("cuda.pathfinder")
    beside = Path(pathfinder.load_nvidia_dynamic_lib("cudss").abs_path).with_name(_THREADS)
    return str(beside) if beside.is_file() else None
