"""Additional Rayleigh coefficients of groups of a model, and derivatives by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.affine import AffineSystem
from updyn.sensitivity import Unknowns
from updyn.updating.judge.causes.altered import AlteredPart, SystemAlteration, replace_system
from updyn.updating.problem.parameters import Parameter
from updyn.updating.problem.problem import FRFPart

__all__ = [
    "ALL",
    "MATRICES",
    "RayleighIncrement",
    "compute_rayleigh_slopes",
    "list_fixed_coefficients",
]


#: Name for all groups.
ALL = "all"
#: Matrix of a group by the Rayleigh coefficient that multiplies it.
MATRICES = {"stiffness_damping": "stiffness", "mass_damping": "mass"}


@dataclass(frozen=True, slots=True)
class RayleighIncrement(SystemAlteration):
    """Increase of ``"stiffness_damping"`` (s) or ``"mass_damping"`` (1/s) of one group or `ALL`."""

    group: str
    quantity: str
    value: float = 0.0

    @classmethod
    def from_name(cls, name: str, value: float = 0.0) -> Self:
        """Return the coefficient of a name ``"GROUP.QUANTITY"``."""
        group, _, quantity = name.rpartition(".")
        return cls(group, quantity, value)

    def list_groups(self, system: AffineSystem) -> list[str]:
        """Return the affected groups of a model."""
        if self.group != ALL:
            return [self.group]
        matrix = MATRICES[self.quantity]
        return [t.group for t in system.terms if t.group and t.quantity == matrix and t.data.any()]

    def make_unknowns(self, system: AffineSystem) -> list[Parameter]:
        """Return the coefficient of each affected group as an unknown."""
        return [
            Parameter(group, self.quantity, 0.0, 0.0, 1.0) for group in self.list_groups(system)
        ]

    def alter_part(self, part: FRFPart) -> FRFPart:
        """Return a part with the increased coefficient."""
        system = part.solver.system
        rate = system.start.rate.copy()
        rate[Unknowns.find(system, self.make_unknowns(system)).at] += self.value
        larger = replace(system, start=replace(system.start, rate=rate))
        return replace(part, solver=replace_system(part, larger))


def list_fixed_coefficients(part: FRFPart) -> list[str]:
    """Return the coefficients that are not unknowns: of each of several groups, and of all."""
    system = part.solver.system
    sought = {drive.name for p in part.coordinates.parameters for drive in p.acts_on}
    found: list[str] = []
    for quantity in MATRICES:
        groups = RayleighIncrement(ALL, quantity).list_groups(system)
        free = [group for group in groups if f"{group}.{quantity}" not in sought]
        if free == groups:
            free = [*(groups if len(groups) > 1 else []), ALL]
        found += [f"{group}.{quantity}" for group in free]
    return found


def compute_rayleigh_slopes(
    part: FRFPart, x: RealArray, names: Sequence[str]
) -> dict[str, ComplexArray]:
    """Return d ln H / d c by Rayleigh coefficients c, by name, shape (n_f, n_i, n_j).

    A name is ``"floors.mass_damping"``, or ``"all.mass_damping"`` for the sum over all groups.
    """
    if isinstance(part, AlteredPart) and isinstance(part.alteration, RayleighIncrement):
        part = part.alteration.alter_part(part.unaltered_part)
    system = replace(part.solver.system, start=part.state(x))
    solver = replace_system(part, system)
    members = {name: RayleighIncrement.from_name(name).make_unknowns(system) for name in names}
    coefficients = list(dict.fromkeys(one for parameters in members.values() for one in parameters))
    unknowns = Unknowns.find(system, coefficients)
    channels = (part.frf.freq, part.rows, part.columns)
    H, dH = sensitivity.receptance(solver, unknowns, system.start.rate[unknowns.at], *channels)
    assert dH is not None
    by_one = dict(zip(coefficients, dH / np.where(H == 0.0, 1.0, H), strict=True))
    return {
        name: np.asarray(sum(by_one[p] for p in parameters)) for name, parameters in members.items()
    }
