"""Metrics of frequency response functions. Pure functions on arrays (lines, responses, references).

Sources: Heylen & Lammens, Proc. Int. Conf. Identification in Engineering Systems (1996) 48-57
(FRAC); Grafe, PhD thesis, Imperial College, 1998 (CSAC chi_s, CSF chi_a); Pascual, Golinval &
Razeto, IMAC XV (1997) 587-592 (FDAC).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.correlation.shapes import ratio
from updyn.errors import DataError

__all__ = ["csac", "csf", "db_error", "fdac", "frac"]

Array = NDArray[np.float64]


def frac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Frequency response assurance criterion over lines (Heylen & Lammens 1996).

    |sum conj(h_X) h_A|^2 / (sum |h_X|^2 sum |h_A|^2) for each response and reference.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_responses, n_references)
        Between 0 and 1; blind to a constant factor. 0 where either function is zero at all lines.

    Raises
    ------
    DataError
        If the shapes differ or a number is not finite.
    """
    hx, ha = _functions(HX, HA)
    above = np.abs(np.sum(hx.conj() * ha, axis=0)) ** 2
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=0) * np.sum(np.abs(ha) ** 2, axis=0))


def csac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Cross signature assurance criterion chi_s at each line, |h_X^H h_A|^2 / (h_X^H h_X h_A^H h_A) (Grafe 1998).

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed; at each line all pairs of response and reference form one vector.

    Returns
    -------
    ndarray of float, shape (n_f,)
        Between 0 and 1; blind to a factor common to a line. 0 where either vector is zero.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = (h.reshape(len(h), -1) for h in _functions(HX, HA))
    above = np.abs(np.sum(hx.conj() * ha, axis=1)) ** 2
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=1) * np.sum(np.abs(ha) ** 2, axis=1))


def csf(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Cross signature scale factor chi_a at each line, 2 |h_X^H h_A| / (h_X^H h_X + h_A^H h_A) (Grafe 1998).

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        As `csac`.

    Returns
    -------
    ndarray of float, shape (n_f,)
        Between 0 and 1; 1 only for equal vectors but for a common phase. 0 where both are zero.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = (h.reshape(len(h), -1) for h in _functions(HX, HA))
    above = 2.0 * np.abs(np.sum(hx.conj() * ha, axis=1))
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=1) + np.sum(np.abs(ha) ** 2, axis=1))


def fdac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Frequency domain assurance criterion: chi_s between every computed and every measured line (Pascual et al. 1997).

    Parameters
    ----------
    HX : array_like of complex, shape (n_x, n_responses, n_references)
        Measured.
    HA : array_like of complex, shape (n_a, n_responses, n_references)
        Computed; its lines may differ.

    Returns
    -------
    ndarray of float, shape (n_a, n_x)
        Between 0 and 1, row: line of the computed, column: line of the measured. A ridge off the
        diagonal shows a frequency shift. 0 where either vector is zero.

    Raises
    ------
    DataError
        If responses or references differ, or a number is not finite.
    """
    hx, ha = _functions(HX, HA, same_lines=False)
    x, a = hx.reshape(len(hx), -1), ha.reshape(len(ha), -1)
    above = np.abs(a.conj() @ x.T) ** 2
    return ratio(above, np.outer(np.sum(np.abs(a) ** 2, axis=1), np.sum(np.abs(x) ** 2, axis=1)))


def db_error(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Difference of level, |20 log10 (|h_A| / |h_X|)| in dB, at each line, response and reference.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_f, n_responses, n_references)
        Not negative. 0 where both are zero, inf where one of them is.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = _functions(HX, HA)
    x, a = np.abs(hx), np.abs(ha)
    out = np.full(x.shape, np.inf)
    both = (x > 0) & (a > 0)
    # A difference of logarithms: the quotient of a tiny and a huge number would leave the range of
    # the format.
    out[both] = np.abs(20.0 * (np.log10(a[both]) - np.log10(x[both])))
    out[(x == 0) & (a == 0)] = 0.0
    return out


def _functions(
    HX: ArrayLike, HA: ArrayLike, *, same_lines: bool = True
) -> tuple[NDArray[Any], NDArray[Any]]:
    arrays = []
    for name, given in (("HX", HX), ("HA", HA)):
        array = np.asarray(given, dtype=np.complex128)
        if array.ndim != 3 or 0 in array.shape:
            raise DataError(
                f"{name}: expected (lines, responses, references), found an array of shape"
                f" {array.shape}"
            )
        if not np.isfinite(array).all():
            line, row, column = np.argwhere(~np.isfinite(array))[0]
            raise DataError(
                f"{name}: line {line + 1}, response {row + 1}, reference {column + 1} is not finite"
            )
        arrays.append(array)
    x, a = arrays
    if x.shape[1:] != a.shape[1:] or (same_lines and len(x) != len(a)):
        raise DataError(
            f"HX has shape {x.shape}, HA {a.shape}; expected the same lines, responses and"
            " references"
        )
    return x, a
