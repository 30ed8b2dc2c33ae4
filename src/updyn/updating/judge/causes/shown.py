"""Faults that the data show by themselves, whatever the model."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Irreparable
from updyn.updating.problem.problem import Part

__all__ = ["LIKELY", "Shown", "ShownFault"]

#: Logarithm of the odds from which a fault is found: 100 to 1.
LIKELY = float(np.log(100.0))


@dataclass(frozen=True, slots=True)
class Shown:
    """A fault that the data show, and how clearly.

    Attributes
    ----------
    fault : ShownFault
        The fault.
    log_odds : float
        Logarithm of the odds that the data have it.
    share : float
        Share of the data that it concerns.
    """

    fault: ShownFault
    log_odds: float
    share: float


class ShownFault(Irreparable):
    """A fault that is found in the data alone, and not by comparison with the model.

    Attributes
    ----------
    symptom : bool
        Whether a fault of another kind may be behind it; it is told where none was found.
    """

    __slots__ = ()

    symptom: ClassVar[bool] = False

    @classmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Return none: the model is not asked."""
        return ()

    @classmethod
    @abstractmethod
    def shown(cls, frf: FRF) -> Iterable[Shown]:
        """Return what the data show, where its odds are 100 to 1 or more.

        Parameters
        ----------
        frf : FRF
            The data, with their variance as far as it is known.
        """

    def set_aside(self, frf: FRF) -> FRF:
        """Return the data in which the values concerned do not count for other faults."""
        return frf

    def is_expected(self, part: Part) -> bool:
        """Return whether sound data would show it as well, by the model of a part.

        Raises
        ------
        SolverError
            If the model cannot be solved.
        """
        return False
