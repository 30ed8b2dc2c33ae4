"""How many threads a factorisation may use."""

from __future__ import annotations

from updyn.linalg import pardiso

__all__ = ["limit"]


def limit(n: int) -> None:
    """Limit the threads of PARDISO (of MKL) in this process; nothing happens where MKL is not installed.

    Meant for worker processes, one thread each, and to be called before the first factorisation: PARDISO plans its
    analysis for the threads there are. Neither numpy's own BLAS nor another backend is touched, and MKL is told
    directly: limiting it by threadpoolctl as well may hang.

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
    if pardiso.available():
        pardiso.library().MKL_Set_Num_Threads(int(n))
