"""`SearchingMethod`: base class of methods that search a basin by log error before they fit."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass

from updyn.errors import OptionError
from updyn.updating.fit.method import Method
from updyn.updating.fit.search import Search
from updyn.updating.fit.settings import SEARCH

__all__ = ["SearchingMethod"]


@dataclass(frozen=True, slots=True)
class SearchingMethod(Method, ABC):
    """A method that searches from several starts; `starts` is 0 if `max_iterations` is 0.

    With 0 starts, the fit begins at the start of the unknowns. `max_iterations` is the largest
    number of steps of the final fit, and of each try (there at most 60). `inflate` raises the loss
    factors at the start of a search.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    starts: int = 8
    seed: int = 0
    inflate: bool = True

    def __post_init__(self) -> None:
        if self.starts > SEARCH.most_tries:
            raise OptionError(
                f"option starts = {self.starts}: expected at most {SEARCH.most_tries:,} tries of"
                " the search",
                key=("starts",),
            )
        if self.max_iterations == 0:
            object.__setattr__(self, "starts", 0)

    @property
    def stages(self) -> tuple[tuple[str, int], ...]:
        """The search, if any, and the fit."""
        fit = (self.name, self.max_iterations)
        if not self.starts:
            return (fit,)
        return (("search", self.starts * min(self.max_iterations, SEARCH.steps)), fit)

    @property
    def tries(self) -> Search:
        """The search."""
        steps = min(self.max_iterations, SEARCH.steps)
        return Search(self.starts, steps, seed=self.seed, inflate=self.inflate)
