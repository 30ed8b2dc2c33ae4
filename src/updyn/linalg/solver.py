"""Checked sparse solves with complex or real symmetric matrices of one pattern.

`SparseSolver` analyses a pattern once, factorises matrices of it by a backend and checks every
answer by its backward error. A backend is a class as `Backend` describes it, registered in
`BACKENDS`.

Where memory is short, real matrices are factorised in single precision, in 0.6 of the time and the
memory (Langou, Langou, Luszczek, Kurzak, Buttari & Dongarra, Proc. ACM/IEEE SC 2006), and answers
are refined. One step of refinement of a load that excites every mode says how far the factors are
from the matrix; where they are too far, double precision takes over.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, SolverError, key_path
from updyn.registry import Registry

__all__ = [
    "BACKENDS",
    "LARGEST_GROWTH",
    "LARGEST_PROBE_GROWTH",
    "RESIDUAL",
    "Backend",
    "Factorised",
    "Factors",
    "SparseSolver",
    "accuracy",
    "check_backend",
    "growth",
    "probe_load",
    "singular_message",
    "unit_scale",
]


class Factors(Protocol):
    """A factorised matrix; valid until its backend factorises another."""

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real matrix; None where it is not known."""

    def __call__(self, B: NDArray[Any], /) -> NDArray[Any]:
        """Solve for right-hand sides of the matrix's kind, shape (n, r)."""


class Backend(Protocol):
    """A sparse direct solver: one pattern, analysed once, for complex or (`real`) real matrices."""

    #: How to install it, for the message where it is missing.
    install: str
    #: Whether it can be made with `single`: real matrices and loads, which are given in double
    #: precision, are worked on in single. May be left out; False then.
    has_single: bool

    def __init__(self, pattern: Any, *, real: bool = False, single: bool = False) -> None: ...

    @staticmethod
    def available() -> bool:
        """Return whether the library is installed and can be loaded."""

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the library, estimated before `factor`; None if unknown."""

    def factor(self, A: Any) -> Factors:
        """Factorise a matrix of the pattern. Raises RuntimeError and MemoryError."""

    def release(self) -> None:
        """Give the memory back; the object is of no more use."""


#: Backends by name, the preferred one first. SuperLU is always there; what stands after it is used
#: only where it is named. One registered at run time is known in this process only; worker
#: processes find those of entry points.
BACKENDS: Registry[type[Backend]] = Registry(
    "backend",
    "updyn.backends",
    {
        "pardiso": "updyn.linalg.pardiso:Pardiso",
        "mumps": "updyn.linalg.mumps:Mumps",
        "superlu": "updyn.linalg.superlu:SuperLU",
        "cudss": "updyn.linalg.cudss:Cudss",
    },
)
#: Relative error of an answer of factors in single precision.
_DIGITS = 1e-6
#: Backends that are tried in this order where another one fails.
_FALLBACKS = ("pardiso", "mumps", "superlu")


def check_backend(name: str | None) -> str:
    """Return the backend to use: the one named, else the first that is installed.

    Raises
    ------
    OptionError
        If there is none of that name, or it is not installed.
    """
    if name is None:
        return next(known for known in BACKENDS if BACKENDS[known].available())
    with key_path("backend"):
        backend = BACKENDS.find(name)
        if not backend.available():
            raise OptionError(
                f"backend {name!r} is not installed; {backend.install}, or use 'superlu'"
            )
    return name


@dataclass(slots=True, eq=False)
class SparseSolver:
    """Solve with matrices of one pattern; the analysis is kept between calls.

    Only one factorisation is alive at a time: its memory serves the next.

    Parameters
    ----------
    backend : str
        One of `BACKENDS`.
    real : bool
        Matrices are real (and may be indefinite) instead of complex: 2.5 times faster, in half the
        memory.
    single : bool
        Factorise real matrices in single precision where the backend and the matrix allow it, and
        refine answers to the `error` that is asked for.

    Attributes
    ----------
    used : dict
        How many solves each backend answered; another than `backend` only where that one failed.
    refined : int
        How many of them needed a step of refinement.
    """

    backend: str
    real: bool = field(default=False, kw_only=True)
    single: bool = field(default=False, kw_only=True)
    used: dict[str, int] = field(default_factory=dict, init=False)
    refined: int = field(default=0, init=False)
    _analysed: dict[_Way, Backend] = field(default_factory=dict, init=False)
    _pattern: tuple[NDArray[Any], NDArray[Any]] | None = field(default=None, init=False)
    _alive: weakref.ref[Factorised] | None = field(default=None, init=False)

    def __reduce__(self) -> tuple[Any, ...]:
        # In another process it begins anew: what a library holds cannot be sent there.
        return partial(SparseSolver, real=self.real, single=self.single), (self.backend,)

    def solve(self, A: Any, B: NDArray[Any], freq: float, held: str = "") -> NDArray[Any]:
        """Solve A X = B once and check the answer.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), symmetric, of the solver's kind
            Matrix; sorted, with a full diagonal.
        B : ndarray, shape (n, r)
            Right-hand sides.
        freq : float
            The line in Hz, for messages.
        held : str
            Which DOFs are held, for messages.

        Returns
        -------
        ndarray of A's kind, shape (n, r)

        Raises
        ------
        SolverError
            If A is singular to rounding, memory is short, or the residual |A X - B| of a column
            exceeds 1e-8 of |A| |X| + |B| even after one step of refinement and with the other
            backends.
        """
        factorised = self.factorise(A, freq, held)
        try:
            return factorised.solve(B)
        finally:
            self._retire()

    def factorise(
        self,
        A: Any,
        freq: float,
        held: str = "",
        *,
        error: float = _DIGITS,
        single_only: bool = False,
    ) -> Factorised:
        """Factorise A for right-hand sides that come later; an earlier factorisation ends.

        Parameters
        ----------
        A : sparse CSC, shape (n, n), symmetric, of the solver's kind
            Matrix; sorted, with a full diagonal. Not to be changed while it is solved with.
        freq : float
            The line or shift in Hz, for messages.
        held : str
            Which DOFs are held, for messages.
        error : float
            Relative error that answers may have where the solver works in single precision.
        single_only : bool
            Whether double precision, which takes twice the memory, does not take over there.

        Returns
        -------
        Factorised

        Raises
        ------
        SolverError
            If A is singular, or memory is short, or A too close to singular for single precision
            alone.
        TypeError
            If A is not of the solver's kind.
        """
        if np.iscomplexobj(A) == self.real:
            raise TypeError(
                f"a {'real' if self.real else 'complex'} solver was given a matrix of {A.dtype}"
            )
        self._retire()
        self._forget_other_pattern(A)
        made = Factorised(self, A, (freq, held), error, self._ways(single_only=single_only))
        self._alive = weakref.ref(made)
        return made

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the backends in use; None where it is unknown."""
        known = [b for backend in self._analysed.values() if (b := backend.peak_bytes) is not None]
        return max(known, default=None)

    def release(self) -> None:
        """Give all memory back now; a later call analyses anew."""
        self._retire()
        for backend in self._analysed.values():
            backend.release()
        self._analysed.clear()
        self._pattern = None

    def _retire(self) -> None:
        if self._alive is not None:
            alive = self._alive()
            if alive is not None:
                alive._factors = None
        self._alive = None

    def _ways(self, *, single_only: bool) -> Iterator[_Way]:
        """Yield how to factorise: by the backend asked for, then by those where it fails."""
        for name in _backends_from(self.backend):
            if not BACKENDS[name].available():
                continue
            if self.single and getattr(BACKENDS[name], "has_single", False):
                yield _Way(name, single=True)
                if single_only:
                    return
            yield _Way(name)

    def _factor(self, way: _Way, A: Any) -> Factors:
        if way not in self._analysed:
            single = {"single": True} if way.single else {}
            self._analysed[way] = BACKENDS[way.name](A, real=self.real, **single)
        return self._analysed[way].factor(A)

    def _forget(self, way: _Way) -> None:
        """Free a backend that failed, before another needs the memory."""
        failed = self._analysed.pop(way, None)
        if failed is not None:
            failed.release()

    def _forget_other_pattern(self, A: Any) -> None:
        known = self._pattern
        same = known is not None and (
            (known[0] is A.indptr and known[1] is A.indices)
            or (np.array_equal(known[0], A.indptr) and np.array_equal(known[1], A.indices))
        )
        if not same:
            self.release()
            self._pattern = (A.indptr, A.indices)


@dataclass(frozen=True, slots=True)
class _Way:
    """A backend and its precision."""

    name: str
    single: bool = False

    @property
    def residual(self) -> float:
        """Backward error above which an answer is not accepted."""
        return RESIDUAL_SINGLE if self.single else RESIDUAL


def _backends_from(name: str) -> Iterator[str]:
    """Yield a backend, then those to try where it fails."""
    yield name
    after = 0
    if name in _FALLBACKS:
        after = _FALLBACKS.index(name) + 1
    yield from _FALLBACKS[after:]


class Factorised:
    """A factorised matrix of a `SparseSolver`, valid until the solver factorises another."""

    __slots__ = (
        "_A",
        "__weakref__",
        "_error",
        "_factors",
        "_line",
        "_off",
        "_probed",
        "_scale",
        "_solver",
        "_way",
        "_ways",
    )

    def __init__(
        self,
        solver: SparseSolver,
        A: Any,
        line: tuple[float, str],
        error: float,
        ways: Iterator[_Way],
    ) -> None:
        self._solver, self._A, self._line, self._error, self._ways = solver, A, line, error, ways
        self._scale = unit_scale(A.diagonal())
        self._factors: Factors | None = None
        self._way: _Way | None = None
        self._off = _EXACT
        # A real matrix is shifted to just beside an eigenvalue on purpose.
        self._probed = solver.real
        if not self._factored_by_next():
            raise SolverError(singular_message(*line, scale=self._scale))

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real A (Sylvester's law of inertia); None if unknown.

        For A = K - omega^2 M with M positive definite: how many natural frequencies lie below
        omega.
        """
        return self._current()[0].negative

    @property
    def error(self) -> float:
        """Relative error that answers may have; 0 in double precision."""
        return self._error if self._current()[1].single else 0.0

    def times(self, X: NDArray[Any]) -> NDArray[Any]:
        """Return A X, X of shape (n, r)."""
        return np.asarray(self._A @ X)

    def solve(self, B: NDArray[Any]) -> NDArray[Any]:
        """Solve A X = B and check the answer.

        Parameters
        ----------
        B : ndarray, shape (n, r)
            Right-hand sides.

        Returns
        -------
        ndarray of A's kind, shape (n, r)

        Raises
        ------
        SolverError
            As `SparseSolver.solve`.
        RuntimeError
            If the solver has factorised another matrix since, or was released.
        """
        _, way = self._current()
        if self._solver.real and np.iscomplexobj(B):
            raise TypeError("a real solver was given complex right-hand sides")
        n, r = B.shape
        if self._probed:
            B = np.asfortranarray(B, dtype=np.float64 if self._solver.real else np.complex128)
        else:
            loads = np.empty((n, r + 1), dtype=np.complex128, order="F")
            loads[:, :r], loads[:, r:] = B, probe_load(self._scale)
            B = loads
        while True:
            try:
                X, left, grown = self._refined(B)
            except RuntimeError:
                left = np.inf
            if left <= way.residual:
                break
            if not self._factored_by_next():
                if np.isinf(left):
                    raise SolverError(singular_message(*self._line, scale=self._scale))
                where = f"residual {left:.1e} at {self._line[0]:g} Hz"
                raise SolverError(f"{way.name}: {where}; the matrix is singular there or nearly so")
            _, way = self._current()
        if not (grown[:r] <= LARGEST_GROWTH).all() or not (grown[r:] <= LARGEST_PROBE_GROWTH).all():
            raise SolverError(singular_message(*self._line, scale=self._scale))
        self._probed = True
        self._solver.used[way.name] = self._solver.used.get(way.name, 0) + 1
        return X[:, :r]

    def _refined(self, B: NDArray[Any]) -> tuple[NDArray[Any], float, NDArray[np.float64]]:
        """Return the solution, its largest backward error and the growth of each column.

        Columns that are off after all are corrected once more.
        """
        run, way = self._current()
        X = run(B)
        if way.single:
            self._settle(run, X, B)
        errors, grown = accuracy(self._A, self._scale, X, B, way.residual)
        off = ~(errors <= way.residual)
        if off.any():
            with np.errstate(invalid="ignore", over="ignore"):
                X[:, off] += run(np.asfortranarray(B[:, off] - self._A @ X[:, off]))
            errors[off], grown[off] = accuracy(
                self._A, self._scale, X[:, off], B[:, off], way.residual
            )
            self._solver.refined += 1
        return X, float(errors.max(initial=0.0)), grown

    def _settle(self, run: Factors, X: NDArray[Any], B: NDArray[Any]) -> None:
        """Refine answers of factors in single precision until they are as exact as they are to be.

        Raises
        ------
        RuntimeError
            If they do not come to rest.
        """
        left, before = self._off.share, 1.0
        for _ in range(_MOST_STEPS):
            if left <= max(self._error, self._off.floor):
                return
            change = run(np.asfortranarray(B - self._A @ X))
            X += change
            size = float(_grown(_sizes(change, self._scale), _sizes(X, self._scale)).max(initial=0))
            left, before = size * max(self._off.share, size / before), size
        raise RuntimeError(f"answers in single precision do not settle: {left:.1e} off")

    def _factored_by_next(self) -> bool:
        """Factorise with the next backend that can; False if none is left."""
        self._factors = None
        for way in self._ways:
            if self._way is not None:
                self._solver._forget(self._way)
            self._way = way
            try:
                factors = self._solver._factor(way, self._A)
                self._off = self._off_by(factors) if way.single else _EXACT
            except RuntimeError:
                continue
            except MemoryError as error:
                # Others need no less, and would end the process instead.
                message = f"{way.name}: not enough memory to factorise {self._A.shape[0]} DOFs"
                if str(error):
                    message += f" ({error})"
                raise SolverError(message) from error
            if self._off.share <= _FARTHEST:
                self._factors = factors
                return True
            del factors
        return False

    def _off_by(self, factors: Factors) -> _Off:
        """Return how far factors in single precision are from those of the matrix A.

        They are those of A + E. A step of refinement changes an answer by A^-1 E times it, and
        leaves an error of that share. Where it is far below 1 no eigenvalue crosses zero on the way
        from A + E to A, so that their negative ones are as many.
        """
        load = np.asfortranarray(probe_load(self._scale).real)
        with np.errstate(invalid="ignore", over="ignore"):
            X = factors(load)
            change = factors(np.asfortranarray(load - self._A @ X))
            size = _sizes(X, self._scale)
            share = _grown(_sizes(change, self._scale), size)
            grown = _grown(size, _sizes(load, 1.0 / self._scale))
        return _Off(float(share[0]), _ROUNDINGS * np.finfo(float).eps * float(grown[0]))

    def _current(self) -> tuple[Factors, _Way]:
        if self._factors is None or self._way is None:
            raise RuntimeError(
                "this factorisation has ended: its solver has factorised another matrix, or was"
                " released"
            )
        return self._factors, self._way


#: Backward error above which an answer is not accepted, in double and in single precision.
RESIDUAL, RESIDUAL_SINGLE = 1e-8, 1e-4


@dataclass(frozen=True, slots=True)
class _Off:
    """How far factors are from those of the matrix.

    Attributes
    ----------
    share : float
        What a step of refinement leaves of the error of an answer to a load that excites every
        mode.
    floor : float
        Relative error of an answer below which refining it does not help.
    """

    share: float
    floor: float


_EXACT = _Off(0.0, 0.0)
#: The largest share that steps of refinement make good, and how many steps an answer takes at most.
_FARTHEST, _MOST_STEPS = 0.2, 20
#: Roundings of double precision in a residual, about.
_ROUNDINGS = 4.0

#: A solution that outgrows its right-hand side by this has lost 12 of its 16 digits: the matrix
#: counts as singular.
LARGEST_GROWTH = 1e12

#: The same for a load that excites every mode (`probe_load`). At a natural frequency that is hit to
#: rounding it grows by 1e14 or more, by an amount that depends on the kernel of BLAS. The forces of
#: a test may grow by less than 1e12 there, if they excite that mode little.
LARGEST_PROBE_GROWTH = 1e13

#: Sizes on the diagonal from whose ratio on rounding may be what makes a matrix singular. Rotations
#: in N m/rad beside translations in N/m reach a part of it.
_FAR_APART = 1e9

#: Columns that are checked by one combination of them.
_CHECKED_COLUMNS = 64

#: Entries of a matrix that BLAS multiplies with a vector in one thread (OpenBLAS: up to 9216).
_ALONE = 8192
#: Numbers that are worked on at a time, so that they stay in the cache.
_CACHED_NUMBERS = 2**15


def unit_scale(diagonal: NDArray[Any]) -> NDArray[np.float64]:
    """Return the scale that makes rows and columns of a matrix comparable, whatever their units.

    Parameters
    ----------
    diagonal : ndarray of float or complex, shape (..., n)
        Of the matrix; N/m or N m/rad on its rows.

    Returns
    -------
    ndarray of float, shape (..., n)
        A DOF without an entry of its own cannot be compared; it gets 1e-8 of the largest, 1 if all
        are zero.
    """
    scale = np.sqrt(np.abs(diagonal))
    largest = scale.max(axis=-1, keepdims=True, initial=0.0)
    return np.asarray(np.where(largest > 0, np.maximum(scale, 1e-8 * largest), 1.0))


def growth(diagonal: NDArray[Any], X: NDArray[Any], B: NDArray[Any]) -> NDArray[np.float64]:
    """Return how far the solution of A X = B outgrows its right-hand side, whatever the units.

    Parameters
    ----------
    diagonal : ndarray of complex, shape (..., n)
        Of A; scales rows and columns, so that translations and rotations compare.
    X, B : ndarray of complex, shape (..., n, r)
        Solution and right-hand sides.

    Returns
    -------
    ndarray of float, shape (...)
        Largest over the columns; about a lower bound of the condition number of the scaled matrix.
    """
    scale = unit_scale(diagonal)[..., None]
    grown = _grown((np.abs(X) * scale).max(axis=-2), (np.abs(B) / scale).max(axis=-2))
    return np.asarray(grown.max(axis=-1, initial=0))


def probe_load(scale: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return a load that excites every mode: entries of random phase, as large as their rows.

    Parameters
    ----------
    scale : ndarray of float, shape (..., n)
        `unit_scale` of the matrix.

    Returns
    -------
    ndarray of complex, shape (..., n, 1)
        The same on every call; its `growth` is close to the condition number of the scaled matrix.
    """
    phase = 2j * np.pi * np.random.default_rng(0).random(scale.shape[-1])
    return np.asarray(np.exp(phase) * scale)[..., None]


def accuracy(
    A: Any,
    scale: NDArray[np.float64],
    X: NDArray[Any],
    B: NDArray[Any],
    allowed: float = RESIDUAL,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Judge the answer of A X = B at the cost of about one column in 64.

    The residual of a random combination of the columns is looked at (Freivalds, 1977), each
    weighted by its size so that a small column counts as much as a large one. Only where it is
    suspicious is every column looked at.

    Parameters
    ----------
    A : sparse, shape (n, n)
        Matrix.
    scale : ndarray of float, shape (n,)
        Its `unit_scale`.
    X, B : ndarray, shape (n, r)
        Solution and right-hand sides.
    allowed : float
        Backward error that is not suspicious.

    Returns
    -------
    errors : ndarray of float, shape (r,)
        Normwise backward error of each column, or a bound of it, in the scaled DOFs:
        max |A x - b| / max (|A| |x| + |b|). Not a number where the solution is not.
    grown : ndarray of float, shape (r,)
        As `growth`, by column, to a factor of 1.4.
    """
    errors, grown = np.zeros(X.shape[1]), np.zeros(X.shape[1])
    absolute = None
    for first in range(0, X.shape[1], _CHECKED_COLUMNS):
        part = slice(first, first + _CHECKED_COLUMNS)
        x, b = X[:, part], B[:, part]
        solved, load = _sizes(x, scale), _sizes(b, 1.0 / scale)
        grown[part] = _grown(solved, load)
        # What is not a number stays so, and is found.
        with np.errstate(invalid="ignore", over="ignore"):
            bound = _combined(A, scale, x, b, solved + load)
            if not bound <= allowed:
                if absolute is None:
                    absolute = abs(A)
                residual = (np.abs(A @ x - b) / scale[:, None]).max(axis=0, initial=0.0)
                size = ((absolute @ np.abs(x) + np.abs(b)) / scale[:, None]).max(
                    axis=0, initial=0.0
                )
                bound = residual / np.maximum(size, _TINY)
        errors[part] = bound
    return errors, grown


_TINY = np.finfo(float).tiny


def _combined(
    A: Any, scale: NDArray[np.float64], x: NDArray[Any], b: NDArray[Any], size: NDArray[np.float64]
) -> np.float64:
    """Return a bound of the backward errors of columns from a random combination of them."""
    r = len(size)
    weight = np.random.default_rng(0).uniform(0.5, 1.5, r) / np.maximum(size, _TINY)
    y, c = _times(x, weight), _times(b, weight)
    # |A| |y| is at least the diagonal's part of it, which spares |A|.
    error = (np.abs(A @ y - c) / scale).max(initial=0.0)
    # One column's weight is at least a third of each other's.
    size_of_both = max((np.abs(y) * scale).max(initial=0.0), (np.abs(c) / scale).max(initial=_TINY))
    return np.float64(3 * r * error / size_of_both)


def _times(X: NDArray[Any], weight: NDArray[np.float64]) -> NDArray[Any]:
    """Return X @ weight, in pieces so small that BLAS keeps to one thread.

    More would wait for the cores on which the threads of the solver still spin.
    """
    step = max(1, _ALONE // len(weight))
    return np.concatenate([X[i : i + step] @ weight for i in range(0, len(X), step)])


def _sizes(X: NDArray[Any], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest scaled real or imaginary part of each column."""
    if np.iscomplexobj(X):
        scale = np.repeat(scale, 2)
    columns = np.asfortranarray(X).T.view(np.float64)
    step = max(1, _CACHED_NUMBERS // len(scale))
    pieces = [columns[i : i + step] for i in range(0, len(columns), step)]
    return np.concatenate([(np.abs(piece) * scale).max(axis=1, initial=0.0) for piece in pieces])


def _grown(solved: NDArray[np.float64], load: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = solved / load
    # 0 / 0: a column without load.
    return np.where(np.isfinite(solved), np.nan_to_num(grown, nan=0.0), np.inf)


def singular_message(freq: float, held: str = "", *, scale: NDArray[np.float64]) -> str:
    """Return the message on a singular line: which it is, and what to do.

    Parameters
    ----------
    freq : float
        In Hz.
    held : str
        Which DOFs are held.
    scale : ndarray of float, shape (n,)
        `unit_scale` of the matrix.
    """
    if freq == 0.0:
        why = "the structure is free to move there. Leave the line out or support the structure"
    else:
        why = (
            "a natural frequency without damping. Leave the line out or give the groups a loss"
            " factor"
        )
    smallest, largest = float(scale.min()) ** 2, float(scale.max()) ** 2
    if largest > _FAR_APART * smallest:
        why += (
            f". Or stiffnesses too far apart for double precision: the sizes on the diagonal go"
            f" from {smallest:.1g} to {largest:.1g}, and what is soft is lost in the rounding of"
            " what is stiff. Merge the stiff part into a rigid one, or make it softer"
        )
    return f"the dynamic stiffness {held}is singular at {freq:g} Hz: {why}"
