"""Consistent units of decks and matrix files: conversion to SI, and a check of moduli.

With a unit of length L (m), a unit of energy W (J) and angles in rad, a matrix A of stiffness,
damping or mass becomes W T A T with T = 1/L at translations and 1 at rotations, because u^T A u is
an energy (or power, or twice an energy over seconds squared) in every system.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import OptionError, UpdynWarning, suggest
from updyn.io.settings import MATERIAL_RANGE
from updyn.model import Matrix

__all__ = ["UNITS", "UnitSystem", "check_materials", "find_units"]


@dataclass(frozen=True, slots=True)
class UnitSystem:
    """A consistent system of units, always with seconds and radians; length in m, energy in J.

    `description` has the units of length, force and mass, as text.
    """

    name: str
    length: float
    energy: float
    description: str

    def to_si(self, matrix: Matrix, dofs: DofSet) -> Matrix:
        """Return a matrix of stiffness, damping or mass, given in this system, in SI."""
        if self.length == self.energy == 1.0:
            return matrix
        entry = sp.coo_array(matrix)
        power = (dofs.axes < 3).astype(np.int64)
        # Combined powers of the unit of length make 1e-3 / 1e-3^2 equal to 1000 within rounding.
        factors = np.array([self.energy * (1.0 / self.length) ** k for k in range(3)])
        data = entry.data * factors[power[entry.row] + power[entry.col]]
        return sp.csr_array(sp.coo_array((data, (entry.row, entry.col)), shape=entry.shape))

    @property
    def pressure(self) -> float:
        """Unit of a modulus, in Pa."""
        return self.energy / self.length**3

    @property
    def density(self) -> float:
        """Unit of a density, in kg/m3."""
        return self.energy / self.length**5


_POUND_FORCE = (
    4.4482216152605  # N, exact (International Bureau of Weights and Measures, SI brochure)
)
UNITS = {
    s.name: s
    for s in (
        UnitSystem("m", 1.0, 1.0, "m, N, kg"),
        UnitSystem("mm", 1e-3, 1e-3, "mm, N, t"),
        UnitSystem("in", 0.0254, 0.0254 * _POUND_FORCE, "in, lbf, lbf s2/in"),
    )
}


def find_units(name: str) -> UnitSystem:
    """Return a system of units by its unit of length; raise an OptionError if it is unknown."""
    if name not in UNITS:
        known = "; ".join(f"{s.name!r} ({s.description})" for s in UNITS.values())
        raise OptionError(
            f"unit {name!r}; {suggest(str(name), UNITS)} Consistent units: {known}, all with s"
        )
    return UNITS[name]


def check_materials(
    materials: Iterable[tuple[str, float | None, float | None]],
    chosen: UnitSystem,
    path: str | Path,
) -> None:
    """Warn if moduli and densities are not those of a solid in the given units.

    `materials` has name, Young's modulus and density; None if not given.
    """
    for name, modulus, density in materials:
        if _is_plausible(modulus, density, chosen):
            continue
        others = [
            s for s in UNITS.values() if s is not chosen and _is_plausible(modulus, density, s)
        ]
        hint = (
            f"they fit unit = {others[0].name!r} ({others[0].description})"
            if others
            else "they fit none of "
            + ", ".join(repr(s) for s in UNITS)
            + ": units are mixed in the deck"
        )
        values = " and ".join(
            f"{what} {value:g} ({value * factor:.3g} {unit})"
            for what, value, factor, unit in (
                ("modulus", modulus, chosen.pressure, "Pa"),
                ("density", density, chosen.density, "kg/m3"),
            )
            if value is not None
        )
        warnings.warn(
            f"{path}: material {name!r}: {values} is not plausible in unit = {chosen.name!r}"
            f" ({chosen.description}); {hint}",
            UpdynWarning,
            stacklevel=2,
        )
        return


def _is_plausible(modulus: float | None, density: float | None, chosen: UnitSystem) -> bool:
    E = None if not modulus else modulus * chosen.pressure
    rho = None if not density else density * chosen.density
    if E is not None and not MATERIAL_RANGE.least_modulus <= E <= MATERIAL_RANGE.most_modulus:
        return False
    if rho is not None and not MATERIAL_RANGE.least_density <= rho <= MATERIAL_RANGE.most_density:
        return False
    if E is None or rho is None:
        return True
    speed = float(np.sqrt(abs(E / rho)))
    return MATERIAL_RANGE.least_speed <= speed <= MATERIAL_RANGE.most_speed
