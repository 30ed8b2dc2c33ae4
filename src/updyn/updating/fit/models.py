"""`Models`: the model in which other answers of a fit are looked for, point by point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.answer import Answer
from updyn.updating.problem.problem import Problem

__all__ = ["Models"]


@dataclass(slots=True, eq=False)
class Models:
    """One model that is accurate everywhere; derived classes have one that is made so at a point.

    Parameters
    ----------
    exact : Problem
        Data, unknowns and the whole model.

    Attributes
    ----------
    ranks : bool
        Whether points are only ranked in `rough`, and judged near them.
    """

    exact: Problem

    ranks: ClassVar[bool] = False

    @property
    def rough(self) -> Problem:
        """The problem with the model in which points far from the answer are compared."""
        return self.exact

    def near(self, x: NDArray[np.float64]) -> Problem:
        """Return the problem with a model that is accurate about a point.

        Parameters
        ----------
        x : ndarray of float, shape (n,)
            The point. Asked again there, the model may be more accurate; it is the same object
            where it is accurate enough.
        """
        return self.exact

    def is_rough(self, x: NDArray[np.float64]) -> bool:
        """Return whether `rough` is good enough to rank a point, but not to judge it."""
        return False

    def is_known(self, x: NDArray[np.float64], answer: Answer) -> bool:
        """Return whether a point is an answer again, so that it need not be fitted."""
        return False

    def leads_back(self, x: NDArray[np.float64], answer: Answer, unlikelihood: float) -> bool:
        """Return whether a descent from a point is known to end in an answer.

        Parameters
        ----------
        x : ndarray of float, shape (n,)
            The point.
        answer : Answer
            The answer.
        unlikelihood : float
            Minus the log-likelihood at the point.
        """
        return False
