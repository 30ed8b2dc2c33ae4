"""`Criterion`: selection of a layout, and the registry of criteria."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.model_modes import ModelModes
from updyn.dynamics.modes import Modes
from updyn.planning.information import Candidates, PairInformation
from updyn.planning.layout import Layout, OverPoints, best_layout
from updyn.registry import Registry
from updyn.updating.problem.optimal_design import AOptimal, DesignScore, DOptimal

__all__ = ["CRITERIA", "Criterion", "Planning", "volume_score"]


@dataclass(frozen=True, eq=False)
class Planning:
    """Input of a criterion."""

    #: Model, candidate responses and references, and lines of the band.
    candidates: Candidates
    #: Fisher information of every pair, at the start of the parameters and at further points.
    information: PairInformation
    #: Indices of the parameters of interest.
    wanted: tuple[int, ...]

    @cached_property
    def modes(self) -> Modes:
        """Undamped flexible modes in the band, otherwise below it; `DataError` if none exist."""
        freq = self.candidates.freq
        found = ModelModes(self.candidates.model).undamped(float(freq[-1]))
        inside = found.frequency >= freq[0]
        return found.select(inside) if inside.any() else found

    @property
    def response_shapes(self) -> RealArray:
        """Target modes at the candidate responses, shape (n_i, n_modes), in 1/sqrt(kg)."""
        return np.asarray(self.modes.at(self.candidates.responses))

    @property
    def reference_shapes(self) -> RealArray:
        """Target modes at the candidate references, shape (n_j, n_modes), in 1/sqrt(kg)."""
        return np.asarray(self.modes.at(self.candidates.references))


class Criterion(ABC):
    """Selects a layout from candidates; derive from it, and state its `source`."""

    #: Reference: author, journal, year.
    source: ClassVar[str]
    #: Whether candidates may be screened by their information if they are very many.
    by_information: ClassVar[bool] = False

    @abstractmethod
    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select responses and references.

        Parameters
        ----------
        planning : Planning
            Candidates and their information.
        n_responses, n_references : int
            Numbers to select, at most those of the candidates.

        Returns
        -------
        Layout

        Raises
        ------
        DataError
            If the criterion does not apply to this model and band.
        """

    def score(self, planning: Planning) -> DesignScore:
        """Return the score of the gains; by default that of the volume.

        Parameters
        ----------
        planning : Planning
            Candidates and their information.

        Returns
        -------
        DesignScore
        """
        return volume_score(planning)


def volume_score(planning: Planning) -> DesignScore:
    """Return the score of the volume of the confidence ellipsoid of the parameters of interest."""
    # Minus twice the logarithm of the geometric mean of its semi-axes (at one standard deviation),
    # averaged over the points of the parameters, up to a constant.
    n = len(planning.information.scale)
    others = tuple(i for i in range(n) if i not in planning.wanted)
    return OverPoints(_PerUnknown(DOptimal(others), len(planning.wanted)))


@dataclass(frozen=True, slots=True)
class _PerUnknown(DesignScore):
    """A score divided by the number of its parameters."""

    base: DesignScore
    n: int

    def score(self, information: RealArray) -> RealArray:
        return np.asarray(self.base.score(information) / self.n)


class DOptimalLayout(Criterion):
    """Smallest volume of the confidence ellipsoid of the parameters of interest."""

    by_information = True
    source = "Fedorov, Theory of Optimal Experiments, 1972, chapters 2 and 3"

    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select by greedy selection and exchange."""
        score = self.score(planning)
        return best_layout(planning.information, n_responses, n_references, score)


class AOptimalLayout(Criterion):
    """Smallest mean variance of the parameters of interest, each relative to its minimum.

    The minimum is the variance with all candidates at the start of the parameters.
    """

    by_information = True
    source = "Fedorov, Theory of Optimal Experiments, 1972, chapter 2"

    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select by greedy selection and exchange."""
        score = self.score(planning)
        return best_layout(planning.information, n_responses, n_references, score)

    def score(self, planning: Planning) -> DesignScore:
        """Return the score of the mean variance."""
        information = planning.information
        rows, columns = map(range, information.shape)
        whole = information.of_layout(rows, columns)[0]
        return OverPoints(AOptimal.of(whole, planning.wanted))


#: The criteria by name. Another package registers a class derived from `Criterion` by a call of
#: `CRITERIA.register`, or by an entry point.
CRITERIA: Registry[type[Criterion]] = Registry(
    "planning criterion",
    "updyn.plan_criteria",
    {
        "d-optimal": DOptimalLayout,
        "a-optimal": AOptimalLayout,
        "effective-independence": "updyn.planning.classical:EffectiveIndependence",
        "mac": "updyn.planning.classical:LeastMac",
        "driving-point-residue": "updyn.planning.classical:DrivingPointResidue",
    },
)
