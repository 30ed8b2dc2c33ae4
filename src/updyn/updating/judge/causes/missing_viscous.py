"""Viscous damping that the model lacks: a dashpot, or in proportion to stiffness or mass."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.loss_over_frequency import LossOverFrequency
from updyn.updating.judge.causes.missing_element import MissingElement
from updyn.updating.judge.causes.proportional import ProportionalDamping
from updyn.updating.judge.causes.rates import list_fixed_coefficients
from updyn.updating.judge.causes.settings import MISSING_ELEMENT
from updyn.updating.problem.problem import FRFPart

__all__ = ["MissingViscous", "count_viscous_places"]


class MissingViscous(MissingElement):
    """A dashpot of `value` N s/m at a DOF, or between two, that the model lacks.

    Viscous damping in proportion to the stiffness or the mass of a group is of the same kind.
    """

    __slots__ = ()

    kind: ClassVar[str] = "missing-viscous"
    unit: ClassVar[str] = "N s/m"
    quantity: ClassVar[str] = "viscous"
    noun: ClassVar[str] = "dashpot"
    units: ClassVar[tuple[str, str]] = ("N s/m", "N m s/rad")

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Fault]:
        """Yield the dashpots that explain most, to first order, and the damping of each group."""
        varying_loss_factors = {
            viscous.channels: one
            for one in LossOverFrequency.propose_faults(evidence)
            for viscous in one.viscous
        }
        n_places = count_viscous_places(evidence.part)
        yield from (
            replace(one, n_places=n_places) for one in cls.find_best(evidence, MISSING_ELEMENT.most)
        )
        for one in ProportionalDamping.propose_faults(evidence):
            yield replace(
                one, n_places=n_places, varying_loss_factor=varying_loss_factors.get(one.channels)
            )


def count_viscous_places(part: FRFPart) -> int:
    """Return the number of places of dashpots and of groups whose damping is not an unknown."""
    return len(list(MissingViscous.list_places(part))) + len(list_fixed_coefficients(part))
