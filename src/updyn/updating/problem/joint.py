"""Several tests at once: problems that share their unknowns, seen by the methods as one.

A `Problem` is one test; a `Joint` is several. Both have what a method asks for: the unknowns'
coordinates, the parts, and how much data there is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.updating.problem.problem import Coordinates, Problem
from updyn.updating.problem.session import Record, Session

__all__ = ["Joint", "Task", "together"]

_Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Problems with the same unknowns and the same session.

    Attributes
    ----------
    parts : tuple of Problem
        One for each test; their names differ.
    """

    parts: tuple[Problem, ...]

    @property
    def coordinates(self) -> Coordinates:
        """The optimiser's coordinates, the same for all parts."""
        return self.parts[0].coordinates

    @property
    def session(self) -> Session:
        """Where the lines of all parts are solved."""
        return self.parts[0].session

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.parts[0].n

    @property
    def n_values(self) -> int:
        """Number of measured values of all parts."""
        return sum(part.n_values for part in self.parts)

    @property
    def n_lines(self) -> int:
        """Number of lines of all parts."""
        return sum(part.n_lines for part in self.parts)

    @property
    def spreads(self) -> bool:
        """Whether the lines of one evaluation are worth spreading over workers; else whole descents are."""
        return any(part.spreads for part in self.parts)

    def thinned(self, largest: int) -> Joint:
        """Return the parts on at most `largest` lines each."""
        return Joint(tuple(part.thinned(largest) for part in self.parts))

    def lowest(self, share: float) -> Joint:
        """Return the parts on a share of their lines, from the lowest."""
        return Joint(tuple(part.lowest(share) for part in self.parts))

    def with_session(self, session: Session) -> Joint:
        """Return the parts with another session."""
        return Joint(tuple(part.with_session(session) for part in self.parts))

    def with_box(self, box: tuple[_Vector, _Vector]) -> Joint:
        """Return the parts with narrower bounds in x."""
        return Joint(tuple(part.with_box(box) for part in self.parts))

    def recall(
        self, kind: str, x: _Vector, compute: Callable[[], Record], *about: object
    ) -> Record:
        """Return the result of an evaluation of all parts at x, from memory where it is known."""
        if self.session.memory is None:
            return compute()
        return self.session.recall(
            [k for part in self.parts for k in part.key(kind, x, *about)], compute
        )


#: What a method works on.
Task: TypeAlias = "Problem | Joint"


def together(problems: Sequence[Problem]) -> Task:
    """Return one problem as it is, several as one, in the coordinates of the first."""
    first = problems[0]
    rest = (
        p if p.coordinates is first.coordinates else replace(p, coordinates=first.coordinates)
        for p in problems
    )
    return first if len(problems) == 1 else Joint(tuple(rest))
