"""cuDSS for symmetric matrices on a graphics card, through nvmath-python (extra ``updyn[cuda]``).

The pattern is analysed once and stays on the card; values and right-hand sides go there for each
factorisation and solve, solutions come back. Only the upper triangle is stored (L D L^T). Phases,
matrix types and parameters as in the cuDSS reference, version 0.8.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from updyn.linalg.solver import unit_scale
from updyn.linalg.triangle import upper_triangle

__all__ = ["Cudss"]

#: Of cuDSS. Parameters have other numbers in other versions; nvmath-python 1.0 has those of this.
_VERSION = (0, 8)
#: Pivots below, of a matrix whose diagonal is scaled to one, are perturbed: not accepted.
_SMALLEST_PIVOT = 1e-13
#: Lets several threads order the equations; part of cuDSS.
_THREADS = "libcudss_mtlayer_gomp.so.0"


@cache
def _libraries() -> Any:
    """Return the bindings of cuDSS and CUDA; None where they, or a card, are missing."""
    try:
        cudss = importlib.import_module("nvmath.bindings.cudss")
        cuda = importlib.import_module("cuda.bindings.runtime")
        version = (cudss.get_property(0), cudss.get_property(1))
    except (ImportError, OSError, RuntimeError):  # bindings may be there without what they bind
        return None
    error, cards = cuda.cudaGetDeviceCount()
    if error or not cards or version != _VERSION:
        return None
    return SimpleNamespace(cudss=cudss, cuda=cuda)


class Cudss:
    """One pattern, analysed once.

    Rows and columns are scaled, so that what counts as a small pivot does not depend on units.

    Parameters
    ----------
    pattern : sparse CSC, shape (n, n)
        A matrix of the pattern: symmetric, sorted.
    real : bool
        Matrices are real, definite or not, instead of complex.

    Raises
    ------
    RuntimeError
        If the library reports an error.
    MemoryError
        If the card has not enough memory.
    """

    install = "pip install 'updyn[cuda]' (a card of NVIDIA with a driver for CUDA 13)"

    @staticmethod
    def available() -> bool:
        """Return whether the bindings, cuDSS and a card are there."""
        return _libraries() is not None

    def __init__(self, pattern: Any, *, real: bool = False) -> None:
        self._kind: np.dtype[Any] = np.dtype(np.float64 if real else np.complex128)
        self._upper, begin = upper_triangle(pattern.indptr, pattern.indices)
        self._column = pattern.indices[self._upper].astype(np.int32)
        self._lengths = np.diff(begin)
        with ExitStack() as held:
            self._card = _Card.opened(held)
            self._values = self._card.room(held, len(self._column) * self._kind.itemsize)
            self._matrix = self._card.sparse(
                held, begin.astype(np.int32), self._column, self._values, self._kind
            )
            # What is solved for plays no part before there is something to solve.
            self._none = self._card.dense(held, np.zeros((len(self._lengths), 1), self._kind))[0]
            self._card.run("ANALYSIS", self._matrix, self._none, self._none)
            # The card's memory goes with this object; at the interpreter's end with the process.
            self._end = finalize(self, held.pop_all().close)
            self._end.atexit = False

    @property
    def peak_bytes(self) -> int:
        """Largest memory on the card, the factor included; estimated before `factor`."""
        return int(self._card.told("MEMORY_ESTIMATES", np.int64, 16)[1])

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
            If the library reports an error, or had to perturb a pivot.
        MemoryError
            If the card has not enough memory.
        """
        scale = 1.0 / unit_scale(A.diagonal())
        values = A.data[self._upper].astype(self._kind, copy=False)
        values *= scale[self._column]
        values *= np.repeat(scale, self._lengths)
        self._card.put(self._values, values)
        self._card.run("FACTORIZATION", self._matrix, self._none, self._none)
        perturbed = int(self._card.told("NPIVOTS", np.int32, 1)[0])
        if perturbed:
            # A perturbed pivot makes a singular matrix look like a regular one.
            raise RuntimeError(f"cuDSS perturbed {perturbed} pivots")
        negative = None
        if self._kind == np.float64:
            negative = int(self._card.told("INERTIA", np.int32, 2)[1])
        return _LDL(self._card, self._matrix, scale, self._kind, negative)

    def release(self) -> None:
        """Give the card's memory back; the object is of no more use."""
        self._end()


@dataclass(frozen=True, slots=True, eq=False)
class _LDL:
    card: _Card
    matrix: int
    scale: NDArray[np.float64]
    kind: np.dtype[Any]
    negative: int | None

    def __call__(self, B: NDArray[Any]) -> NDArray[Any]:
        x = np.empty(B.shape, dtype=self.kind, order="F")
        if not x.size:
            return x
        np.multiply(B, self.scale[:, None], out=x)
        with ExitStack() as held:
            load, _ = self.card.dense(held, x)
            solution, place = self.card.dense(held, x)
            self.card.run("SOLVE", self.matrix, solution, load)
            self.card.get(x, place)
        x *= self.scale[:, None]
        return x


@dataclass(frozen=True, slots=True, eq=False)
class _Card:
    """A session of cuDSS. What it makes lasts as long as the stack that is given for it."""

    cudss: Any
    cuda: Any
    handle: int
    config: int
    data: int

    @classmethod
    def opened(cls, held: ExitStack) -> _Card:
        """Begin a session."""
        found = _libraries()
        cudss = found.cudss
        with _named_errors(cudss):
            handle = cudss.create()
            held.callback(cudss.destroy, handle)
            config = cudss.config_create()
            held.callback(cudss.config_destroy, config)
            data = cudss.data_create(handle)
            held.callback(cudss.data_destroy, handle, data)
            threads = _thread_library()
            if threads is not None:
                cudss.set_threading_layer(handle, threads)
        made = cls(cudss, found.cuda, handle, config, data)
        made.set("PIVOT_EPSILON", np.float64, _SMALLEST_PIVOT)
        return made

    def set(self, name: str, kind: type, value: float) -> None:
        """Set a parameter."""
        told: NDArray[Any] = np.array([value], dtype=kind)
        parameter = self.cudss.ConfigParam[name]
        with _named_errors(self.cudss):
            self.cudss.config_set(self.config, parameter, told.ctypes.data, told.nbytes)

    def told(self, name: str, kind: type, n: int) -> NDArray[Any]:
        """Return what the library knows of its last phase."""
        told: NDArray[Any] = np.zeros(n, dtype=kind)
        written = np.zeros(1, dtype=np.uint64)
        with _named_errors(self.cudss):
            self.cudss.data_get(
                self.handle, self.data, self.cudss.DataParam[name],
                told.ctypes.data, told.nbytes, written.ctypes.data,
            )  # fmt: skip
        return told

    def room(self, held: ExitStack, n_bytes: int) -> int:
        """Return where memory of the card begins."""
        place = self._checked(self.cuda.cudaMalloc(n_bytes))
        held.callback(self.cuda.cudaFree, place)
        return int(place)

    def put(self, place: int, array: NDArray[Any]) -> None:
        """Copy an array to the card."""
        to_card = self.cuda.cudaMemcpyKind.cudaMemcpyHostToDevice
        self._checked(self.cuda.cudaMemcpy(place, array.ctypes.data, array.nbytes, to_card))

    def get(self, array: NDArray[Any], place: int) -> None:
        """Copy from the card into an array."""
        to_host = self.cuda.cudaMemcpyKind.cudaMemcpyDeviceToHost
        self._checked(self.cuda.cudaMemcpy(array.ctypes.data, place, array.nbytes, to_host))

    def sparse(
        self,
        held: ExitStack,
        begin: NDArray[np.int32],
        column: NDArray[np.int32],
        values: int,
        kind: np.dtype[Any],
    ) -> int:
        """Return an upper triangle, shape (n, n), whose values are on the card."""
        places = [self.room(held, array.nbytes) for array in (begin, column)]
        for place, array in zip(places, (begin, column), strict=True):
            self.put(place, array)
        n, cudss = len(begin) - 1, self.cudss
        index = cudss.DataType.R_32I
        with _named_errors(cudss):
            made = cudss.matrix_create_csr(
                n, n, len(column), places[0], 0, places[1], values, index, index,
                self._value_type(kind), cudss.MatrixType.SYMMETRIC, cudss.MatrixViewType.UPPER,
                cudss.IndexBase.ZERO,
            )  # fmt: skip
        held.callback(cudss.matrix_destroy, made)
        return int(made)

    def dense(self, held: ExitStack, array: NDArray[Any]) -> tuple[int, int]:
        """Return a copy of an array on the card, shape (n, r), and where its values begin."""
        place, cudss = self.room(held, array.nbytes), self.cudss
        self.put(place, array)
        n, r = array.shape
        with _named_errors(cudss):
            made = cudss.matrix_create_dn(
                n, r, n, place, self._value_type(array.dtype), cudss.Layout.COL_MAJOR
            )
        held.callback(cudss.matrix_destroy, made)
        return int(made), place

    def run(self, phase: str, matrix: int, solution: int, load: int) -> None:
        """Execute a phase and wait for its end."""
        with _named_errors(self.cudss, phase):
            self.cudss.execute(
                self.handle, self.cudss.Phase[phase], self.config, self.data, matrix, solution, load
            )
        self._checked(self.cuda.cudaDeviceSynchronize())
        error = int(self.told("INFO", np.int32, 1)[0])
        if error:
            raise RuntimeError(f"cuDSS error {error} in phase {phase}")

    def _value_type(self, kind: np.dtype[Any]) -> Any:
        types = self.cudss.DataType
        if kind == np.float64:
            return types.R_64F
        return types.C_64F

    def _checked(self, answer: tuple[Any, ...]) -> Any:
        """Return what a function of CUDA returned beside its error code."""
        error, *values = answer
        if error == self.cuda.cudaError_t.cudaErrorMemoryAllocation:
            raise MemoryError("of the graphics card")
        if error:
            raise RuntimeError(f"CUDA: {error.name}")
        return values[0] if values else None


@contextmanager
def _named_errors(cudss: Any, phase: str = "") -> Iterator[None]:
    """Give errors of the library the types of the protocol."""
    try:
        yield
    except cudss.cuDSSError as error:
        if error.status == cudss.Status.ALLOC_FAILED:
            raise MemoryError("of the graphics card") from error
        where = f" in phase {phase}" if phase else ""
        raise RuntimeError(f"cuDSS: {error}{where}") from error


def _thread_library() -> str | None:
    """Return the library, installed beside cuDSS, that lets it order equations in threads."""
    pathfinder = importlib.import_module("cuda.pathfinder")
    beside = Path(pathfinder.load_nvidia_dynamic_lib("cudss").abs_path).with_name(_THREADS)
    return str(beside) if beside.is_file() else None
