"""Limits of the threads of factorisations and of the products around them."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from updyn.linalg.pardiso import library

__all__ = ["alone", "limit"]

P = ParamSpec("P")
R = TypeVar("R")

#: Whether the limit of `alone` is set already, by a function that called this one.
_is_alone = ContextVar("_is_alone", default=False)


def alone(function: Callable[P, R]) -> Callable[P, R]:
    """Let OpenBLAS, the library of numpy and scipy, work in one thread while a function runs.

    For many small factorisations and products. Its threads wait for each other at every one of
    them; where a core is busy with something else, that takes 5 to 50 times as long (measured: 300
    equations, two cores). MKL is not touched.

    Parameters
    ----------
    function : callable
        Works on batches of small matrices.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        if _is_alone.get():  # setting a limit takes as long as a small product
            return function(*args, **kwargs)
        token = _is_alone.set(True)
        try:
            with _openblas().limit(limits=1):
                return function(*args, **kwargs)
        finally:
            _is_alone.reset(token)

    return limited


@cache
def _openblas() -> Any:
    import scipy.linalg  # noqa: F401  (brings an OpenBLAS of its own, which has to be there to be found)
    from threadpoolctl import ThreadpoolController

    # Found once: looking for libraries takes milliseconds. MKL is limited directly; limited here as
    # well, it may hang.
    return ThreadpoolController().select(internal_api="openblas")


def limit(n: int) -> None:
    """Limit the threads of MKL, and so of PARDISO, in this process; without MKL do nothing.

    Meant for worker processes, one thread each, and to be called before the first factorisation:
    PARDISO plans its analysis for the threads there are. Neither numpy's own BLAS nor another
    backend is touched, and MKL is limited directly: limiting it by threadpoolctl as well may hang.

    Parameters
    ----------
    n : int
        At least 1.

    Raises
    ------
    ValueError
        If n is below 1.
    """
    if n < 1:
        raise ValueError(f"threads: {n}; at least 1 is needed")
    mkl = library()
    if mkl is not None:
        mkl.MKL_Set_Num_Threads(int(n))
