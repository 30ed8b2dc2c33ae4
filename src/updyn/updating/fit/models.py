"""`Models`: the models in which other answers of a fit are searched for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from updyn.arrays import RealArray
from updyn.updating.fit.answer import Answer
from updyn.updating.problem.problem import Problem

__all__ = ["Models"]


@dataclass(slots=True, eq=False)
class Models:
    """One model that is accurate everywhere; derived classes refine a model at each point.

    With `only_ranks`, points are ranked in `rough` and judged in `near`.
    """

    exact: Problem

    only_ranks: ClassVar[bool] = False

    @property
    def rough(self) -> Problem:
        """Problem with the model in which points far from the answer are compared."""
        return self.exact

    def near(self, x: RealArray) -> Problem:
        """Return the problem with a model that is accurate near a point.

        Repeated calls may refine the model further; they return the same object if it is accurate
        enough.
        """
        return self.exact

    def is_rough(self, x: RealArray) -> bool:
        """Return whether `rough` is accurate enough to rank a point, but not to judge it."""
        return False

    def is_known(self, x: RealArray, answer: Answer) -> bool:
        """Return whether a point is the same as an answer and need not be fitted."""
        return False

    def leads_back(self, x: RealArray, answer: Answer, negative_log_likelihood: float) -> bool:
        """Return whether a descent from a point is known to end in an answer."""
        return False
