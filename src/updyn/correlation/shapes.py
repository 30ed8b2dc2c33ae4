"""Correlation of mode shapes, given as columns: MAC, COMAC, ECOMAC, and the pairing of modes.

Sources: Allemang & Brown, IMAC I (1982) 110-116 (MAC); Allemang, Sound and Vibration 37 (8) (2003)
14-21 (cross-orthogonality, ECOMAC); Lieven & Ewins, IMAC VI (1988) 690-695 (COMAC); Hunt, IMAC X
(1992) 66-71 (ECOMAC); Bjorck & Golub, Math. Comp. 27 (1973) 579-594 (principal angles).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, IndexArray, NumberArray, RealArray
from updyn.correlation.settings import MODE_PAIRING
from updyn.errors import DataError

__all__ = [
    "ModePairs",
    "auto_mac",
    "comac",
    "compute_cosines",
    "cross_orthogonality",
    "ecomac",
    "find_moving",
    "mac",
    "orthonormalise",
    "pair_modes",
    "principal_cosines",
    "ratio",
    "unit_shapes",
]

Array = RealArray


def mac(A: ArrayLike, B: ArrayLike) -> Array:
    """Modal assurance criterion, |a^H b|^2 / (a^H a b^H b) (Allemang & Brown 1982).

    Parameters
    ----------
    A, B : array_like, shape (N, n_a) and (N, n_b)
        Shapes as columns at the same DOFs in the same order; real or complex, any scale.

    Returns
    -------
    ndarray of float, shape (n_a, n_b)
        Between 0 and 1; 1 if one shape is a multiple of the other.

    Raises
    ------
    DataError
        If the row counts differ, or a shape is zero or not finite.
    """
    a, b = unit_shapes("A", A), unit_shapes("B", B)
    _check_same_rows(a, b)
    return np.asarray(np.minimum(np.abs(a.conj().T @ b) ** 2, 1.0))


def principal_cosines(A: ArrayLike, B: ArrayLike) -> Array:
    """Cosines of the principal angles between the spans of shapes (Bjorck & Golub 1973).

    Parameters
    ----------
    A, B : array_like, shape (N, n_a) and (N, n_b)
        Shapes as columns at the same DOFs in the same order; real or complex, any scale.

    Returns
    -------
    ndarray of float
        Descending, between 0 and 1; their number is the dimension of the smaller span. The square
        of the last is the lowest MAC that a shape of the smaller span has with the best
        combination of the other shapes; for two single shapes it is their MAC.

    Raises
    ------
    DataError
        As `mac`.

    Notes
    -----
    Directions in which the shapes of unit length have a singular value below a tenth of the
    largest one are excluded from a span: in measured shapes they are errors.
    """
    a, b = orthonormalise(unit_shapes("A", A)), orthonormalise(unit_shapes("B", B))
    _check_same_rows(a, b)
    return compute_cosines(a, b)


def orthonormalise(unit: NumberArray) -> NumberArray:
    """Return an orthonormal basis of the span of shapes of unit length, shape (N, r)."""
    if unit.shape[1] == 1:
        return unit
    left, size, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(left[:, size > MODE_PAIRING.least_spread * size[0]])


def compute_cosines(a: NumberArray, b: NumberArray) -> Array:
    """Return the cosines of the principal angles between the spans of orthonormal bases."""
    return np.asarray(np.minimum(np.linalg.svd(a.conj().T @ b, compute_uv=False), 1.0))


def auto_mac(A: ArrayLike) -> Array:
    """MAC of shapes with themselves.

    Large off-diagonal values mean that there are too few sensors.

    Parameters
    ----------
    A : array_like, shape (N, n)
        Shapes as columns.

    Returns
    -------
    ndarray of float, shape (n, n)
        Symmetric, 1 on the diagonal.

    Raises
    ------
    DataError
        As `mac`.
    """
    return mac(A, A)


def cross_orthogonality(A: ArrayLike, M: Any, B: ArrayLike) -> NumberArray:
    """Mass-weighted cross-orthogonality, a^H M b / sqrt(a^H M a b^H M b) (Allemang 2003).

    Parameters
    ----------
    A : array_like, shape (N, n_a)
        Shapes as columns, any scale.
    M : array_like or sparse, shape (N, N)
        Mass at these DOFs, in kg (kg m2).
    B : array_like, shape (N, n_b)
        Shapes as columns, any scale.

    Returns
    -------
    ndarray of float or complex, shape (n_a, n_b)
        Modulus 1 for equal modes, 0 for different modes of one structure; the sign is that of the
        shapes.

    Raises
    ------
    DataError
        If sizes differ, or a shape has no mass.
    """
    a, b = _check_shapes("A", A), _check_shapes("B", B)
    _check_same_rows(a, b)
    mass = M if hasattr(M, "tocsr") else np.atleast_2d(np.asarray(M, dtype=np.float64))
    if mass.shape != (len(a), len(a)):
        raise DataError(
            f"mass of shape {mass.shape} for shapes with {len(a)} rows; expected {(len(a), len(a))}"
        )
    weights = []
    for name, shapes in (("A", a), ("B", b)):
        modal_masses = np.einsum("in,in->n", shapes.conj(), mass @ shapes).real
        if (modal_masses <= 0).any():
            raise DataError(
                f"shape {int(np.flatnonzero(modal_masses <= 0)[0]) + 1} of {name} moves no mass"
            )
        weights.append(np.sqrt(modal_masses))
    return np.asarray((a.conj().T @ (mass @ b)) / np.outer(*weights))


def comac(A: ArrayLike, B: ArrayLike) -> Array:
    """Co-ordinate MAC of paired shapes (Lieven & Ewins 1988).

    (sum |a b*|)^2 / (sum |a|^2 sum |b|^2), the sums over modes.

    Parameters
    ----------
    A, B : array_like, shape (N, n)
        Paired shapes as columns: mode r of A with mode r of B; each scaled to unit length here.

    Returns
    -------
    ndarray of float, shape (N,)
        Between 0 and 1, by DOF. 0 if either set is zero at the DOF.

    Raises
    ------
    DataError
        If the shapes of the arrays differ, or a shape is zero.
    """
    a, b = _check_paired(A, B)
    above = np.sum(np.abs(a * b.conj()), axis=1) ** 2
    return ratio(above, np.sum(np.abs(a) ** 2, axis=1) * np.sum(np.abs(b) ** 2, axis=1))


def ecomac(A: ArrayLike, B: ArrayLike) -> Array:
    """Enhanced co-ordinate MAC of paired shapes (Hunt 1992; Allemang 2003).

    sum |a - b| / (2 n), the sum over modes.

    Parameters
    ----------
    A, B : array_like, shape (N, n)
        Paired shapes as columns; each is scaled to unit length here, and b is rotated in phase
        with a.

    Returns
    -------
    ndarray of float, shape (N,)
        By DOF; 0 if there is no difference. Sensitive to wrong gains and signs of a sensor.

    Raises
    ------
    DataError
        As `comac`.
    """
    a, b = _check_paired(A, B)
    inner = np.sum(b.conj() * a, axis=0)
    size = np.abs(inner)
    turn = np.divide(inner, size, out=np.ones_like(inner), where=size > 0)
    return np.asarray(np.sum(np.abs(a - b * turn), axis=1) / (2 * a.shape[1]))


class ModePairs(NamedTuple):
    """Pairs of modes of two sets A and B.

    Attributes
    ----------
    first, second : ndarray of int, shape (k,)
        Column indices of A and of B.
    mac : ndarray of float, shape (k,)
        MAC of each pair.
    """

    first: IndexArray
    second: IndexArray
    mac: Array


def pair_modes(A: ArrayLike, B: ArrayLike, *, minimum: float = 0.0) -> ModePairs:
    """Pair modes one to one with the largest sum of MAC (Hungarian assignment; Kuhn 1955).

    Parameters
    ----------
    A, B : array_like, shape (N, n_a) and (N, n_b)
        Shapes as columns.
    minimum : float
        Least MAC of a pair.

    Returns
    -------
    ModePairs
        At most min(n_a, n_b) pairs, by ascending column of A.

    Raises
    ------
    DataError
        As `mac`.
    """
    from scipy.optimize import linear_sum_assignment

    values = mac(A, B)
    first, second = linear_sum_assignment(values, maximize=True)
    found = values[first, second]
    keep = found >= minimum
    return ModePairs(first[keep], second[keep], found[keep])


def find_moving(at_sensors: NumberArray, shapes: NumberArray) -> BoolArray:
    """Return a mask of the shapes (N, n) that move at DOFs with values `at_sensors` (k, n)."""
    largest = np.abs(shapes).max(axis=0)
    return np.asarray(np.abs(at_sensors).max(axis=0) > MODE_PAIRING.rest_share * largest)


def ratio(above: Array, below: Array) -> Array:
    """Divide; 0 for a denominator of 0, and at most 1."""
    return np.minimum(np.divide(above, below, out=np.zeros_like(below), where=below > 0), 1.0)


def _check_shapes(name: str, given: ArrayLike) -> NumberArray:
    array = np.asarray(given)
    if not (np.issubdtype(array.dtype, np.number)):
        raise DataError(f"{name}: expected numbers, found {array.dtype}")
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or 0 in array.shape:
        raise DataError(
            f"{name}: expected shapes as columns, (DOFs, modes), found an array of shape"
            f" {array.shape}"
        )
    if not np.isfinite(array).all():
        raise DataError(
            f"{name}: shape {int(np.argwhere(~np.isfinite(array))[0][1]) + 1} holds a number not"
            " finite"
        )
    return array * 1.0


def unit_shapes(name: str, given: ArrayLike) -> NumberArray:
    """Return shapes as columns of unit length; errors mention the name."""
    array = _check_shapes(name, given)
    largest = np.abs(array).max(axis=0)
    if (largest == 0).any():
        raise DataError(
            f"{name}: shape {int(np.flatnonzero(largest == 0)[0]) + 1} is zero; it has no direction"
        )
    array = array / largest
    return np.asarray(array / np.linalg.norm(array, axis=0))


def _check_same_rows(a: NumberArray, b: NumberArray) -> None:
    if len(a) != len(b):
        raise DataError(
            f"shapes at {len(a)} and at {len(b)} DOFs; expected the same DOFs in the same order"
        )


def _check_paired(A: ArrayLike, B: ArrayLike) -> tuple[NumberArray, NumberArray]:
    a, b = unit_shapes("A", A), unit_shapes("B", B)
    if a.shape != b.shape:
        raise DataError(
            f"arrays of shape {a.shape} and {b.shape}; expected paired modes (see pair_modes)"
        )
    return a, b
