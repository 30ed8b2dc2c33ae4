"""Limits for the threads of factorisations and of dense products."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from updyn.linalg.pardiso import library

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = ["limit", "use_one_thread"]

P = ParamSpec("P")
R = TypeVar("R")

#: Whether a calling function has already set the limit of `use_one_thread`.
_is_alone = ContextVar("_is_alone", default=False)


def use_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run with one thread of OpenBLAS, the library of numpy and scipy."""
    # In many small factorisations and products, threads wait for each other: on a busy core, that
    # takes 5 to 50 times as long (measured: 300 equations, two cores).

    @wraps(function)
    def run_limited(*args: P.args, **kwargs: P.kwargs) -> R:
        if _is_alone.get():  # setting a limit takes as long as a small product
            return function(*args, **kwargs)
        token = _is_alone.set(True)
        try:
            with _openblas().limit(limits=1):
                return function(*args, **kwargs)
        finally:
            _is_alone.reset(token)

    return run_limited


@cache
def _openblas() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  (loads its OpenBLAS, which must be loaded to be found)
    from threadpoolctl import ThreadpoolController

    # Cached, as the search for libraries takes milliseconds. MKL is limited directly; with a limit
    # here as well, it may hang.
    return ThreadpoolController().select(internal_api="openblas")


def limit(n: int) -> None:
    """Limit the threads of MKL and thus of PARDISO in this process; no effect without MKL."""
    # Call it before the first factorisation: PARDISO plans its analysis for the number of threads.
    # MKL is limited directly, as it may hang with an additional limit by threadpoolctl.
    if n < 1:
        raise ValueError(f"threads: {n}; expected at least 1")
    mkl = library()
    if mkl is not None:
        mkl.MKL_Set_Num_Threads(int(n))
