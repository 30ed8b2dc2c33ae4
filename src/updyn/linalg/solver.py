"""Checked sparse solves with complex or real symmetric matrices of one pattern.

Backends implement `Backend` and are registered in `BACKENDS`; every solution is checked by its
backward error. On request, real matrices are factorised in single precision, in 0.6 of the time and
memory, and solutions are refined (Langou, Langou, Luszczek, Kurzak, Buttari & Dongarra, Proc.
ACM/IEEE SC 2006). One refinement step for a load that excites every mode measures the distance of
the factors from the matrix; if it is too large, double precision is used.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.errors import OptionError, SolverError, key_path
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.registry import Registry

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = [
    "BACKENDS",
    "Backend",
    "Factorised",
    "Factors",
    "SparseSolver",
    "accuracy",
    "check_backend",
    "growth",
    "probe_load",
    "scaled_growth",
    "singular_message",
    "unit_scale",
]


class Factors(Protocol):
    """A factorised matrix, valid until its backend factorises another."""

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real matrix; None if unknown."""

    def __call__(self, B: NumberArray, /) -> NumberArray:
        """Solve for right-hand sides of the matrix's kind, shape (n, r)."""


class Backend(Protocol):
    """A sparse direct solver: one pattern, analysed once, for complex or (`real`) real matrices."""

    #: Installation command for the message if it is missing.
    install: str
    #: Whether it accepts `single`: real matrices and loads are given in double precision and
    #: processed in single precision. Optional; False by default.
    has_single: bool

    def __init__(self, pattern: csc_array, *, real: bool = False, single: bool = False) -> None: ...

    @staticmethod
    def available() -> bool:
        """Return whether the library is installed and can be loaded."""

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the library, estimated before `factor`; None if unknown."""

    def factor(self, A: csc_array) -> Factors:
        """Factorise a matrix of the pattern. Raises RuntimeError and MemoryError."""

    def release(self) -> None:
        """Free the memory; the object cannot be used afterwards."""


#: Backends by name in order of preference. SuperLU is always available; those after it are used
#: only by name. One registered at run time is known in this process only; worker processes find
#: those of entry points.
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
#: Backends tried in this order if another fails.
_FALLBACKS = ("pardiso", "mumps", "superlu")


def check_backend(name: str | None) -> str:
    """Return the named backend, or the first installed one; raises OptionError if unavailable."""
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
    """Solver for matrices of one pattern; only its latest factorisation is valid.

    `real` matrices (possibly indefinite) are 2.5 times faster, in half the memory. `single`
    factorises them in single precision if backend and matrix permit. `solve_counts` has the number
    of solves by backend, others than `backend` only if it failed; `refined` of them needed a
    refinement step.
    """

    backend: str
    real: bool = field(default=False, kw_only=True)
    single: bool = field(default=False, kw_only=True)
    solve_counts: dict[str, int] = field(default_factory=dict, init=False)
    refined: int = field(default=0, init=False)
    _analysed: dict[_BackendChoice, Backend] = field(default_factory=dict, init=False)
    _pattern: tuple[NumberArray, NumberArray] | None = field(default=None, init=False)
    _alive: weakref.ref[Factorised] | None = field(default=None, init=False)

    def __reduce__(self) -> tuple[object, ...]:
        # It starts again in another process, as library data cannot be transferred.
        return partial(SparseSolver, real=self.real, single=self.single), (self.backend,)

    def solve(self, A: csc_array, B: NumberArray, freq: float, held: str = "") -> NumberArray:
        """Solve A X = B, A sparse CSC, symmetric and sorted with a full diagonal, and check X.

        `freq` in Hz and `held`, the held DOFs, are for messages. Raises SolverError if A is
        singular to rounding, memory is short, or the residual |A X - B| of a column exceeds 1e-8 of
        |A| |X| + |B| even after a refinement step and with the other backends.
        """
        factorised = self.factorise(A, freq, held)
        try:
            return factorised.solve(B)
        finally:
            self._invalidate_factors()

    def factorise(
        self,
        A: csc_array,
        freq: float,
        held: str = "",
        *,
        error: float = 0.0,
        single_only: bool = False,
    ) -> Factorised:
        """Factorise A for later right-hand sides; an earlier factorisation becomes invalid.

        A must not change while in use. `error` is the permitted relative error of solutions in
        single precision, 0 for that of double precision; `single_only` excludes double precision,
        which needs twice the memory. Raises SolverError if A is singular or memory is short,
        TypeError if A is real for a complex solver or vice versa.
        """
        if np.iscomplexobj(A) == self.real:
            raise TypeError(
                f"found a matrix of {A.dtype}; expected {'real' if self.real else 'complex'} values"
            )
        self._invalidate_factors()
        self._release_other_pattern(A)
        made = Factorised(self, A, (freq, held), error, self._list_choices(single_only=single_only))
        self._alive = weakref.ref(made)
        return made

    @property
    def peak_bytes(self) -> int | None:
        """Largest memory of the backends in use; None if unknown."""
        known = [b for backend in self._analysed.values() if (b := backend.peak_bytes) is not None]
        return max(known, default=None)

    def release(self) -> None:
        """Free all memory; a later call analyses the pattern again."""
        self._invalidate_factors()
        for backend in self._analysed.values():
            backend.release()
        self._analysed.clear()
        self._pattern = None

    def _invalidate_factors(self) -> None:
        if self._alive is not None:
            alive = self._alive()
            if alive is not None:
                alive._factors = None
        self._alive = None

    def _list_choices(self, *, single_only: bool) -> Iterator[_BackendChoice]:
        """Yield the backends and precisions to try: the requested backend first."""
        for name in _backends_from(self.backend):
            if not BACKENDS[name].available():
                continue
            if self.single and getattr(BACKENDS[name], "has_single", False):
                yield _BackendChoice(name, single=True)
                if single_only:
                    return
            yield _BackendChoice(name)

    def _factor(self, choice: _BackendChoice, A: csc_array) -> Factors:
        if choice not in self._analysed:
            single = {"single": True} if choice.single else {}
            self._analysed[choice] = BACKENDS[choice.name](A, real=self.real, **single)
        return self._analysed[choice].factor(A)

    def _release_choice(self, choice: _BackendChoice) -> None:
        """Free a backend that failed, before another one needs the memory."""
        failed = self._analysed.pop(choice, None)
        if failed is not None:
            failed.release()

    def _release_other_pattern(self, A: csc_array) -> None:
        known = self._pattern
        same = known is not None and (
            (known[0] is A.indptr and known[1] is A.indices)
            or (np.array_equal(known[0], A.indptr) and np.array_equal(known[1], A.indices))
        )
        if not same:
            self.release()
            self._pattern = (A.indptr, A.indices)


@dataclass(frozen=True, slots=True)
class _BackendChoice:
    """A backend and its precision."""

    name: str
    single: bool = False

    @property
    def residual(self) -> float:
        """Largest accepted backward error."""
        return SPARSE_SOLVER.single_backward_error if self.single else SPARSE_SOLVER.backward_error


def _backends_from(name: str) -> Iterator[str]:
    """Yield a backend, then those to try if it fails."""
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
        "_choice",
        "_choices",
        "_error",
        "_factors",
        "_line",
        "_off",
        "_probed",
        "_scale",
        "_solver",
    )

    def __init__(
        self,
        solver: SparseSolver,
        A: csc_array,
        line: tuple[float, str],
        error: float,
        choices: Iterator[_BackendChoice],
    ) -> None:
        self._solver, self._A, self._line, self._error, self._choices = (
            solver,
            A,
            line,
            error,
            choices,
        )
        self._scale = unit_scale(A.diagonal())
        self._factors: Factors | None = None
        self._choice: _BackendChoice | None = None
        self._off = _EXACT
        # A real matrix is deliberately shifted close to an eigenvalue.
        self._probed = solver.real
        if not self._factored_by_next():
            raise SolverError(singular_message(*line, scale=self._scale))

    @property
    def negative(self) -> int | None:
        """Number of negative eigenvalues of a real A (law of inertia); None if unknown."""
        # For K - omega^2 M with positive definite M: the number of natural frequencies below
        # omega.
        return self._latest_factors()[0].negative

    @property
    def error(self) -> float:
        """Permitted relative error of solutions; 0 in double precision."""
        return self._error if self._latest_factors()[1].single else 0.0

    def times(self, X: NumberArray) -> NumberArray:
        """Return A X, X of shape (n, r)."""
        return np.asarray(self._A @ X)

    def solve(self, B: NumberArray) -> NumberArray:
        """Solve A X = B and check X; errors as `SparseSolver.solve`.

        Raises RuntimeError if the solver has factorised another matrix since, or was released.
        """
        _, choice = self._latest_factors()
        if self._solver.real and np.iscomplexobj(B):
            raise TypeError("found complex right-hand sides; expected real ones")
        n, r = B.shape
        if self._probed:
            B = np.asfortranarray(B, dtype=np.float64 if self._solver.real else np.complex128)
        else:
            loads = np.empty((n, r + 1), dtype=np.complex128, order="F")
            loads[:, :r], loads[:, r:] = B, probe_load(self._scale)
            B = loads
        while True:
            try:
                X, error, grown = self._refine_solution(B)
            except RuntimeError:
                error = np.inf
            if error <= choice.residual:
                break
            if not self._factored_by_next():
                if np.isinf(error):
                    raise SolverError(singular_message(*self._line, scale=self._scale))
                where = f"residual {error:.1e} at {self._line[0]:g} Hz"
                raise SolverError(
                    f"{choice.name}: {where}; the matrix is singular or nearly singular"
                )
            _, choice = self._latest_factors()
        loads, probe = grown[:r], grown[r:]
        if not (
            (loads <= SPARSE_SOLVER.largest_growth).all()
            and (probe <= SPARSE_SOLVER.largest_probe_growth).all()
        ):
            raise SolverError(singular_message(*self._line, scale=self._scale))
        self._probed = True
        self._solver.solve_counts[choice.name] = self._solver.solve_counts.get(choice.name, 0) + 1
        return X[:, :r]

    def _refine_solution(self, B: NumberArray) -> tuple[NumberArray, float, RealArray]:
        """Return the solution, its largest backward error and the growth; correct columns once."""
        run, choice = self._latest_factors()
        X = run(B)
        if choice.single:
            self._refine_to_tolerance(run, X, B)
        errors, grown = accuracy(self._A, self._scale, X, B, choice.residual)
        off = ~(errors <= choice.residual)
        if off.any():
            with np.errstate(invalid="ignore", over="ignore"):
                X[:, off] += run(np.asfortranarray(B[:, off] - self._A @ X[:, off]))
            errors[off], grown[off] = accuracy(
                self._A, self._scale, X[:, off], B[:, off], choice.residual
            )
            self._solver.refined += 1
        return X, float(errors.max(initial=0.0)), grown

    def _refine_to_tolerance(self, run: Factors, X: NumberArray, B: NumberArray) -> None:
        """Refine solutions of single-precision factors; RuntimeError if they do not converge."""
        error, before = self._off.share, 1.0
        for _ in range(SPARSE_SOLVER.most_refinements):
            if error <= max(self._error, self._off.floor):
                return
            change = run(np.asfortranarray(B - self._A @ X))
            X += change
            size = float(
                _compute_growth(
                    _column_sizes(change, self._scale), _column_sizes(X, self._scale)
                ).max(initial=0)
            )
            error, before = size * max(self._off.share, size / before), size
        raise RuntimeError(f"solutions in single precision do not converge: error {error:.1e}")

    def _factored_by_next(self) -> bool:
        """Factorise with the next backend; return whether one succeeded."""
        self._factors = None
        for choice in self._choices:
            if self._choice is not None:
                self._solver._release_choice(self._choice)
            self._choice = choice
            try:
                factors = self._solver._factor(choice, self._A)
                self._off = self._distance_from_matrix(factors) if choice.single else _EXACT
            except RuntimeError:
                continue
            except MemoryError as error:
                # Others need as much memory, and would end the process instead.
                message = f"{choice.name}: not enough memory to factorise {self._A.shape[0]} DOFs"
                if str(error):
                    message += f" ({error})"
                raise SolverError(message) from error
            if self._off.share <= SPARSE_SOLVER.largest_remaining_share:
                self._factors = factors
                return True
            del factors
        return False

    def _distance_from_matrix(self, factors: Factors) -> _FactorDistance:
        """Return the distance of factors in single precision, those of A + E, from the matrix A."""
        # A refinement step changes a solution by the share A^-1 E and leaves an error of that
        # share. If it is far below 1, no eigenvalue crosses zero between A + E and A, so both have
        # the same number of negative eigenvalues.
        load = np.asfortranarray(probe_load(self._scale).real)
        with np.errstate(invalid="ignore", over="ignore"):
            X = factors(load)
            change = factors(np.asfortranarray(load - self._A @ X))
            size = _column_sizes(X, self._scale)
            share = _compute_growth(_column_sizes(change, self._scale), size)
            grown = _compute_growth(size, _column_sizes(load, 1.0 / self._scale))
        rounding = SPARSE_SOLVER.residual_rounding * np.finfo(float).eps
        return _FactorDistance(float(share[0]), rounding * float(grown[0]))

    def _latest_factors(self) -> tuple[Factors, _BackendChoice]:
        if self._factors is None or self._choice is None:
            raise RuntimeError(
                "this factorisation is no longer valid: its solver has factorised another matrix,"
                " or was released"
            )
        return self._factors, self._choice


@dataclass(frozen=True, slots=True)
class _FactorDistance:
    """Distance of factors from the matrix, by a load that excites every mode.

    `share` of the error remains after a refinement step; `floor` is the error it cannot reduce.
    """

    share: float
    floor: float


_EXACT = _FactorDistance(0.0, 0.0)


def unit_scale(diagonal: NumberArray) -> RealArray:
    """Return the scale that makes rows and columns of a matrix comparable, independent of units."""
    # DOFs with a zero entry get 1e-8 of the largest scale, or 1 if all are zero.
    scale = np.sqrt(np.abs(diagonal))
    largest = scale.max(axis=-1, keepdims=True, initial=0.0)
    return np.asarray(np.where(largest > 0, np.maximum(scale, 1e-8 * largest), 1.0))


def growth(diagonal: NumberArray, X: NumberArray, B: NumberArray) -> RealArray:
    """Return the largest growth of a solution of A X = B relative to B, shape (...)."""
    # It is approximately a lower bound of the condition number of the matrix scaled by `diagonal`.
    return scaled_growth(unit_scale(diagonal), X, B)


def scaled_growth(scale: RealArray, X: NumberArray, B: NumberArray) -> RealArray:
    """Return `growth` by the `unit_scale` of a diagonal."""
    scale = scale[..., None]
    grown = _compute_growth((np.abs(X) * scale).max(axis=-2), (np.abs(B) / scale).max(axis=-2))
    return np.asarray(grown.max(axis=-1, initial=0))


def probe_load(scale: RealArray) -> ComplexArray:
    """Return a load that excites every mode, shape (..., n, 1): random phases, scaled by row."""
    # The same on every call; its `growth` is close to the condition number of the scaled matrix.
    return np.asarray(_random_phases(scale.shape[-1]) * scale)[..., None]


@lru_cache(maxsize=16)
def _random_phases(n: int) -> ComplexArray:
    """Return n complex numbers of magnitude 1."""
    out = np.exp(2j * np.pi * np.random.default_rng(0).random(n))
    out.flags.writeable = False
    return out


def accuracy(
    A: csc_array,
    scale: RealArray,
    X: NumberArray,
    B: NumberArray,
    allowed: float,
) -> tuple[RealArray, RealArray]:
    """Return backward error and growth of each column of A X = B, at the cost of one column in 64.

    The error, or a bound of it, is normwise in the DOFs scaled by `unit_scale`: max |A x - b| / max
    (|A| |x| + |b|), nan if the solution is nan. The growth is as `growth` within a factor of 1.4.
    """
    # The residual of a random combination of the columns is evaluated (Freivalds, 1977); every
    # column only if it exceeds `allowed`.
    errors, grown = np.zeros(X.shape[1]), np.zeros(X.shape[1])
    absolute = None
    for first in range(0, X.shape[1], SPARSE_SOLVER.columns_per_check):
        part = slice(first, first + SPARSE_SOLVER.columns_per_check)
        x, b = X[:, part], B[:, part]
        solved, load = _column_sizes(x, scale), _column_sizes(b, 1.0 / scale)
        grown[part] = _compute_growth(solved, load)
        # nan propagates and is detected.
        with np.errstate(invalid="ignore", over="ignore"):
            bound = _combination_bound(A, scale, x, b, solved + load)
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


def _combination_bound(
    A: csc_array, scale: RealArray, x: NumberArray, b: NumberArray, size: RealArray
) -> np.float64:
    """Return a bound of the backward errors of columns from a random combination of them."""
    r = len(size)
    weight = np.random.default_rng(0).uniform(0.5, 1.5, r) / np.maximum(size, _TINY)
    y, c = _times(x, weight), _times(b, weight)
    # |A| |y| is at least the part of the diagonal, which avoids computing |A|.
    error = (np.abs(A @ y - c) / scale).max(initial=0.0)
    # One column's weight is at least a third of each other's.
    size_of_both = max((np.abs(y) * scale).max(initial=0.0), (np.abs(c) / scale).max(initial=_TINY))
    return np.float64(3 * r * error / size_of_both)


def _times(X: NumberArray, weight: RealArray) -> NumberArray:
    """Return X @ weight, in pieces small enough for BLAS to use one thread."""
    # More threads would wait for the cores on which the solver's threads still spin.
    step = max(1, SPARSE_SOLVER.one_thread_entries // len(weight))
    return np.concatenate([X[i : i + step] @ weight for i in range(0, len(X), step)])


def _column_sizes(X: NumberArray, scale: RealArray) -> RealArray:
    """Return the largest scaled real or imaginary part of each column."""
    if np.iscomplexobj(X):
        scale = np.repeat(scale, 2)
    columns = np.asfortranarray(X).T.view(np.float64)
    step = max(1, SPARSE_SOLVER.cached_numbers // len(scale))
    pieces = [columns[i : i + step] for i in range(0, len(columns), step)]
    return np.concatenate([(np.abs(piece) * scale).max(axis=1, initial=0.0) for piece in pieces])


def _compute_growth(solved: RealArray, load: RealArray) -> RealArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = solved / load
    # 0 / 0: a column without load.
    return np.where(np.isfinite(solved), np.nan_to_num(grown, nan=0.0), np.inf)


def singular_message(freq: float, held: str = "", *, scale: RealArray) -> str:
    """Return the message on a singular line in Hz, with a remedy; `held` are the held DOFs."""
    if freq == 0.0:
        why = "the structure is free to move. Omit the line or support the structure"
    else:
        why = "a natural frequency without damping. Omit the line or give the groups a loss factor"
    smallest, largest = float(scale.min()) ** 2, float(scale.max()) ** 2
    if largest > SPARSE_SOLVER.named_stiffness_ratio * smallest:
        why += (
            f". Or stiffnesses too far apart for double precision: diagonal entries range"
            f" from {smallest:.1g} to {largest:.1g}, and the soft ones are lost in the rounding of"
            " the stiff ones. Replace the stiff part by a rigid one, or reduce its stiffness"
        )
    return f"the dynamic stiffness {held}is singular at {freq:g} Hz: {why}"
