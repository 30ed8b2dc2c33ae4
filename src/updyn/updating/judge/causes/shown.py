"""Base class of the faults that the data show without a model."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from updyn.frf import FRF
from updyn.updating.judge.causes.fault import IrreparableFault
from updyn.updating.problem.problem import FRFPart

__all__ = ["DataFault", "Detection"]


@dataclass(frozen=True, slots=True)
class Detection:
    """A fault that the data show, its log odds, and the share of the data that it affects."""

    fault: DataFault
    log_odds: float
    share: float


class DataFault(IrreparableFault):
    """A fault that is found in the data alone, without comparison with the model.

    Attributes
    ----------
    is_symptom : bool
        Whether a fault of another kind may be its cause; it is reported if none is found.
    """

    __slots__ = ()

    is_symptom: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Return the faults of this kind with odds of at least 100 to 1.

        Parameters
        ----------
        frf : FRF
            The data, with their variance as far as it is known.
        """

    def mask_values(self, frf: FRF) -> FRF:
        """Return the data in which the affected values have no weight for other faults."""
        return frf

    def is_expected(self, part: FRFPart) -> bool:
        """Return whether correct data would show it as well, according to the model of a part.

        Raises
        ------
        SolverError
            If the model cannot be solved.
        """
        return False
