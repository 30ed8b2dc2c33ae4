"""`RepeatedTests`: natural frequencies of repeated tests, their scatter and that of their means."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import IndexArray, RealArray
from updyn.errors import DataError
from updyn.modal.mode_set import ModeSet
from updyn.modal.settings import REPEATED_TESTS

__all__ = ["RepeatedTests"]


@dataclass(frozen=True, slots=True, eq=False)
class RepeatedTests:
    """Natural frequencies of repeated tests, of one structure reassembled or of several specimens.

    A frequency that a test did not find is nan. It is assumed to be missing at random: whether a
    test finds a mode does not depend on its frequency.

    Parameters
    ----------
    frequency : array_like of float, shape (n, m)
        Frequencies in Hz: a row for each test, a column for each mode.

    Attributes
    ----------
    count : ndarray of int, shape (m,)
        Number of tests that found the mode.
    mean : ndarray of float, shape (m,)
        Mean over the tests that found the mode, in Hz.
    std : ndarray of float, shape (m,)
        Standard deviation of a single test in Hz; nan for modes found by one test
        only, or at the same frequency by all tests.
    correlation : ndarray of float, shape (m, m)
        Correlation between the modes, with unit diagonal. Each pair is estimated from the tests
        that found both modes; pairs with fewer than 4 such tests count as uncorrelated. Negative
        eigenvalues, which the gaps may cause, are set to 0, and the matrix is scaled to unit
        diagonal (Rebonato & Jaeckel, J. Risk 2 (1999) 17). Correlations are then multiplied by 1 -
        `shrinkage`, which makes the matrix positive definite, also with fewer tests than modes.
    shrinkage : float
        The shrinkage that minimises the expected squared error of the correlations (J. Schaefer &
        K. Strimmer, Stat. Appl. Genet. Mol. Biol. 4 (2005) 32, target D).

    Raises
    ------
    DataError
        If the array is not two-dimensional, a mode was found in no test, or a frequency is not
        finite and above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from updyn.modal import RepeatedTests
    >>> tests = RepeatedTests([[10.0, 20.1], [10.2, np.nan], [10.4, 20.5]])
    >>> tests.count
    array([3, 2])
    >>> tests.mean_modes().std_frequency.round(3)
    array([0.115, 0.2  ])
    """

    frequency: RealArray
    count: IndexArray = field(init=False)
    mean: RealArray = field(init=False)
    std: RealArray = field(init=False)
    correlation: RealArray = field(init=False)
    shrinkage: float = field(init=False)

    def __init__(self, frequency: ArrayLike) -> None:
        table = np.array(frequency, dtype=np.float64)
        _check(table)
        found = np.isfinite(table)
        count = found.sum(axis=0)
        mean = np.sum(table, axis=0, where=found) / count
        squares = np.sum((table - mean) ** 2, axis=0, where=found)
        std = np.full(len(count), np.nan)
        is_known = (count > 1) & (squares > 0.0)
        std[is_known] = np.sqrt(squares[is_known] / (count[is_known] - 1))
        correlation, shrinkage = _estimate_correlation(table)
        arrays = {
            "frequency": table,
            "count": count,
            "mean": mean,
            "std": std,
            "correlation": correlation,
        }
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "shrinkage", shrinkage)

    def __len__(self) -> int:
        return len(self.frequency)

    @property
    def covariance(self) -> RealArray:
        """Covariance of the frequencies of a single test in Hz^2, shape (m, m)."""
        return np.asarray(self.correlation * self.std[:, None] * self.std)

    @property
    def covariance_of_mean(self) -> RealArray:
        """Covariance of the means in Hz^2, shape (m, m).

        It is that of a single test times n_ij / (n_i n_j), for means over n_i and n_j tests, n_ij
        of which found both modes.
        """
        found = np.isfinite(self.frequency).astype(np.float64)
        return np.asarray(self.covariance * (found.T @ found) / (self.count[:, None] * self.count))

    def mean_modes(self, source: str = "") -> ModeSet:
        """Return the mean frequencies with their covariance.

        Parameters
        ----------
        source : str
            Origin of the tests, for the record.

        Returns
        -------
        ModeSet
            Natural frequencies without shapes.
        """
        return ModeSet(self.mean, source=source, cov_frequency=self.covariance_of_mean)


def _check(table: RealArray) -> None:
    """Refuse tables that are not frequencies of tests."""
    if table.ndim != 2 or not table.size:
        raise DataError(
            f"repeated tests: expected (tests, modes), found an array of shape {table.shape}"
        )
    is_missing = np.isnan(table)
    bad = np.argwhere(~is_missing & ~((table > 0.0) & np.isfinite(table)))
    if len(bad):
        test, mode = bad[0]
        raise DataError(
            f"repeated tests: test {test + 1}, mode {mode + 1}: {table[test, mode]:g} Hz; expected"
            " a finite frequency above 0, or nan if it was not found"
        )
    if is_missing.all(axis=0).any():
        mode = int(np.argmax(is_missing.all(axis=0)))
        raise DataError(
            f"repeated tests: mode {mode + 1} was found in no test; leave its column out"
        )


def _estimate_correlation(table: RealArray) -> tuple[RealArray, float]:
    """Return the shrunk correlation matrix of the columns, and the shrinkage."""
    m = table.shape[1]
    correlation, variance = np.eye(m), 0.0
    for i, j in zip(*np.triu_indices(m, 1), strict=True):
        pair = table[:, [i, j]]
        pair = pair[np.isfinite(pair).all(axis=1)]
        n = len(pair)
        if n < REPEATED_TESTS.least_common or not np.ptp(pair, axis=0).all():
            continue
        deviation = pair - pair.mean(axis=0)
        product = np.prod(deviation / deviation.std(axis=0, ddof=1), axis=1)
        correlation[i, j] = correlation[j, i] = product.sum() / (n - 1)
        variance += n / (n - 1) ** 3 * float(np.sum((product - product.mean()) ** 2))
    square = float(np.sum(np.triu(correlation, 1) ** 2))
    if square == 0.0:
        return correlation, 1.0
    shrinkage = float(np.clip(variance / square, REPEATED_TESTS.least_shrinkage, 1.0))
    value, vectors = np.linalg.eigh(correlation)
    correlation = (vectors * np.maximum(value, 0.0)) @ vectors.T
    size = np.sqrt(np.diag(correlation))
    correlation *= (1.0 - shrinkage) / (size[:, None] * size)
    np.fill_diagonal(correlation, 1.0)
    return correlation, shrinkage
