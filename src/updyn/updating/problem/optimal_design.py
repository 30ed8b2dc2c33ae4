"""Optimal design: selection of items by the Fisher information that each adds.

An item is a frequency line, a sensor or a force. Its information is a matrix (n, n) of the
unknowns, scaled by that of all items (`scaled`); the information of a design is the sum over its
items. A criterion gives each design a score; `greedy` and `exchanged` maximise it (Fedorov, Theory
of Optimal Experiments, 1972, chapter 3).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["AOptimal", "DOptimal", "DesignScore", "exchanged", "greedy", "initial", "scaled"]

_Real = NDArray[np.float64]

#: Information of each scaled unknown before the first item, for a determinant above 0.
_INITIAL = 1e-9
#: Largest number of exchanges.
_EXCHANGES = 20
#: Smallest increase of the score by an exchange.
_RISE = 1e-6


class DesignScore(ABC):
    """Score of a design by its information; the largest is the best."""

    __slots__ = ()

    @abstractmethod
    def score(self, information: _Real) -> _Real:
        """Return the score of each design.

        Parameters
        ----------
        information : ndarray of float, shape (..., n, n)
            Fisher information of each design, including the initial information.

        Returns
        -------
        ndarray of float, shape (...)
        """


@dataclass(frozen=True, slots=True)
class DOptimal(DesignScore):
    """log det of the information: small volume of the confidence ellipsoid.

    Parameters
    ----------
    others : tuple of int
        Unknowns that are fitted, but do not count. The score is then that of the information on the
        remaining unknowns with these eliminated (D_s-optimality; Atkinson, Donev & Tobias, Optimum
        Experimental Designs, 2007, section 10.3).
    """

    others: tuple[int, ...] = ()

    def score(self, information: _Real) -> _Real:
        """Return log det of the information, less that of `others` if there are any."""
        whole = np.linalg.slogdet(information)[1]
        if not self.others:
            return np.asarray(whole)
        at = list(self.others)
        return np.asarray(whole - np.linalg.slogdet(information[..., at, :][..., at])[1])


@dataclass(frozen=True, slots=True, eq=False)
class AOptimal(DesignScore):
    """Negative logarithm of the mean variance of some unknowns, each relative to its minimum.

    Parameters
    ----------
    wanted : list of int
        The unknowns that count.
    least : ndarray of float, shape (n_wanted,)
        Their variances with all items.
    """

    wanted: list[int]
    least: _Real

    @classmethod
    def of(cls, information: _Real, wanted: Sequence[int]) -> AOptimal:
        """Return the score relative to the variances of a design, such as that of all items.

        Parameters
        ----------
        information : ndarray of float, shape (n, n)
            Information of that design.
        wanted : sequence of int
            The unknowns that count.
        """
        at = list(wanted)
        return cls(at, _variances(information, at))

    def score(self, information: _Real) -> _Real:
        """Return the negative logarithm of the mean relative variance."""
        return np.asarray(
            -np.log((_variances(information, self.wanted) / self.least).mean(axis=-1))
        )


def _variances(information: _Real, wanted: list[int]) -> _Real:
    """Return the variances of some unknowns, shape (..., n_wanted)."""
    unit = np.broadcast_to(np.eye(information.shape[-1]), information.shape)
    covariance = np.linalg.solve(information, unit)
    return np.asarray(np.einsum("...pp->...p", covariance)[..., wanted])


def scaled(information: _Real) -> tuple[_Real, _Real]:
    """Return items scaled by the information of all of them, and the scale.

    Parameters
    ----------
    information : ndarray of float, shape (n_items, n, n)
        Information of each item.

    Returns
    -------
    information : ndarray of float, shape (n_items, n, n)
        Scaled items; the diagonal of their sum is 1.
    scale : ndarray of float, shape (n,)
        Divisor of rows and columns.
    """
    scale = np.sqrt(np.maximum(np.einsum("fpp->p", information), np.finfo(float).tiny))
    return information / scale[:, None] / scale, scale


def initial(n: int) -> _Real:
    """Return the information of `n` scaled unknowns before the first item, shape (n, n)."""
    return _INITIAL * np.eye(n)


def greedy(
    information: _Real, total: _Real, count: int, criterion: DesignScore
) -> tuple[list[int], _Real]:
    """Select items one by one, each with the largest increase of the score.

    Parameters
    ----------
    information : ndarray of float, shape (n_items, ..., n, n)
        Scaled information of each item.
    total : ndarray of float, shape (..., n, n)
        Information before the selection.
    count : int
        Number of items to select.
    criterion : DesignScore
        The score.

    Returns
    -------
    chosen : list of int
        Items in the order of selection.
    total : ndarray of float, shape (..., n, n)
        Information with these items.
    """
    chosen: list[int] = []
    left = np.ones(len(information), dtype=np.bool_)
    for _ in range(count):
        score = criterion.score(total + information)
        score[~left] = -np.inf
        best = int(np.argmax(score))
        chosen.append(best)
        left[best] = False
        total = total + information[best]
    return chosen, total


def exchanged(
    information: _Real, total: _Real, chosen: Sequence[int], criterion: DesignScore
) -> list[int]:
    """Exchange selected items for others, the best pair first, while the score increases.

    Parameters
    ----------
    information : ndarray of float, shape (n_items, ..., n, n)
        Scaled information of each item.
    total : ndarray of float, shape (..., n, n)
        Information of the selected items and of all before.
    chosen : sequence of int
        The selected items.
    criterion : DesignScore
        The score.

    Returns
    -------
    list of int
        The same number of items; a new item has the position of the one that it replaces.
    """
    chosen = list(chosen)
    for _ in range(_EXCHANGES):
        others = np.setdiff1d(np.arange(len(information)), chosen)
        if not others.size:
            break
        now = criterion.score(total)
        rises = [
            criterion.score(total - information[c] + information[others]) - now for c in chosen
        ]
        out, into = np.unravel_index(int(np.argmax(rises)), (len(chosen), len(others)))
        if rises[out][into] < _RISE:
            break
        total = total - information[chosen[out]] + information[others[into]]
        chosen[out] = int(others[into])
    return chosen
