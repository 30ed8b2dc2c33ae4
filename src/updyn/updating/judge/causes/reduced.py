"""The model in which faults are tried: itself, or a reduced one that holds wherever trials go.

Hundreds of short fits are made, from the start as from other points, so that a basis of one point
does not do. The basis is made once of a few points around the start, each solved at another
frequency, and enriched where a decision is taken until its error there is certified. What is left
of that error counts as noise of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.reduction import Across, Reduction
from updyn.frf import QUANTITIES
from updyn.updating.fit.search import scattered
from updyn.updating.judge.causes.evidence import loosened, spread_of
from updyn.updating.judge.causes.holding import HeldSolver, Holding, ground_springs
from updyn.updating.judge.causes.places import places_of
from updyn.updating.problem.problem import Part

__all__ = ["Exact", "Reduced", "Stage", "stage_of"]

_Real = NDArray[np.float64]

#: Larger models than this are reduced.
_DOFS = 100
#: Points around the start whose vectors make the basis; points whose fields choose among them; and
#: the root of the share of the energy of these fields that may be dropped, of a large basis more.
_POINTS, _SAMPLES, _DROPPED = 12, 12, (1e-4, 1e-2)
#: A larger basis is compressed once more.
_LARGE = 150
_ACROSS = Across(shifts=(0.2, 0.5, 0.8), depth=4, combinations=4, lossy=False)
#: So near to a point where the error is certified it is taken to be the same, in x.
_NEAR = 0.05
#: Error wanted where a decision is taken, as a share of the largest receptance of a line.
_ACCURACY = 1e-3
#: Logarithms of what is left of a spring to the ground, of the points at which it does not hold.
_LOOSE = (-1.5, -4.0)
#: Largest loss factor of the points.
_LOSSY = 0.3


class Stage(Protocol):
    """Where trials are made."""

    def near(self, part: Part, points: Sequence[_Real]) -> Part:
        """Return the part with a model that may be relied upon at some points."""


@dataclass(frozen=True, slots=True)
class Exact:
    """The model itself."""

    def near(self, part: Part, points: Sequence[_Real]) -> Part:
        """Return the part as it is."""
        return part


@dataclass(slots=True, eq=False)
class Reduced:
    """A reduced model of a part around its start.

    Parameters
    ----------
    part : Part
        With its whole model.
    """

    part: Part
    _reduction: Reduction = field(init=False)
    _certified: list[_Real] = field(default_factory=list, init=False)
    _error: _Real = field(init=False)
    _holding: Holding = field(init=False)
    _solver: FieldSolver = field(init=False)

    def __post_init__(self) -> None:
        part, freq = self.part, self.part.frf.freq
        places = places_of(part)
        near = np.zeros(0, dtype=np.intp)
        if places:
            near = np.unique(part.solver.system.dofs.match(places).index)
        self._reduction = Reduction(
            part.solver.system,
            part.rows,
            part.columns,
            (float(freq[0]), float(freq[-1])),
            part.solver.backend,
            _ACCURACY,
            near,
            part.session.check,
        )
        points, samples = (_about(part, n, seed) for seed, n in enumerate((_POINTS, _SAMPLES)))
        # A support may not hold the structure at all.
        home, springs = part.coordinates.home, ground_springs(part)
        loose = [loosened(part, home, one, level) for one in springs for level in _LOOSE]
        self._reduction.build_around([part.state(x) for x in points] + loose, across=_ACROSS)
        states = [part.state(x) for x in samples] + loose
        for dropped in _DROPPED:
            self._reduction.compress_around(states, freq, dropped)
            if self._reduction.basis.size <= _LARGE:
                break
        self._error = np.zeros(part.frf.values.shape)
        self._holding = Holding.of(part.solver.system)
        self._solver = self._solver_called("reduced, causes")

    def near(self, part: Part, points: Sequence[_Real]) -> Part:
        """Return the part with the reduced model, enriched where it was not certified.

        Parameters
        ----------
        part : Part
            The same model, whatever the data; they carry their own variance.
        points : sequence of ndarray of float, shape (n,)
            Where the model has to hold.

        Returns
        -------
        Part
            Its data have the variance that the error of the model adds.
        """
        for x in points:
            if not any(np.abs(x - known).max() < _NEAR for known in self._certified):
                self._enrich(x)
        frf = part.frf
        if frf.values.shape == self._error.shape and frf.variance is not None:
            power = QUANTITIES[frf.quantity]
            factor = np.abs(frf.s[:, None, None]) ** power
            frf = replace(frf, variance=frf.variance + (factor * self._error) ** 2)
        return replace(part, solver=self._solver, frf=frf)

    def _enrich(self, x: _Real) -> None:
        certificate = self._reduction.certify(self.part.state(x), self.part.frf.freq)
        self._error = np.maximum(self._error, certificate.errors)
        self._certified.append(x)
        self._solver = self._solver_called(f"reduced, causes {len(self._certified)}")

    def _solver_called(self, label: str) -> FieldSolver:
        label = f"{label} of {self.part.solver.label}"
        return HeldSolver.beside(self._reduction.solver(label), self._holding)


def _about(part: Part, number: int, seed: int) -> list[_Real]:
    """Return the start and points as far from it as the unknowns are expected to be off."""
    own = part.coordinates
    factor, spread = own.parameters.is_factor, spread_of(part)
    lowest = np.where(factor, own.home - spread, 0.0)
    highest = np.where(factor, own.home + spread, np.minimum(own.home + spread, _LOSSY))
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    return [own.home, *np.clip(scattered(middle, half, number - 1, seed), *own.bounds)]


def stage_of(part: Part) -> Stage:
    """Return where the trials of a part are made, by the size of its model.

    Raises
    ------
    SolverError
        If a model that is to be reduced cannot be solved.
    """
    if part.solver.system.n <= _DOFS:
        return Exact()
    return Reduced(part)
