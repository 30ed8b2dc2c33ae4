"""Motion of nonlinear elements in the tests of an update, and their describing functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.periodic.settings import BALANCE
from updyn.errors import UpdynError
from updyn.frf import FRF
from updyn.nonlinear.local import LocalElement
from updyn.nonlinear.over_lines import LineForces, describe_first_harmonic
from updyn.nonlinear.parameters import choose_unit, list_parameters
from updyn.report.settings import REPORT_COMPUTATION
from updyn.updating.level_model import LevelModel
from updyn.updating.result import UpdateResult, interval_quantile

__all__ = [
    "Described",
    "ElementUnits",
    "Motion",
    "describe_element",
    "find_units",
    "follow_loop",
    "gather_motions",
]

#: Probability of a band.
_BAND = 0.95


@dataclass(frozen=True, slots=True)
class Motion:
    """Largest deformation of an element in a test: amplitude (m or rad), and frequency in Hz."""

    test: str
    element: str
    amplitude: float
    freq: float


@dataclass(frozen=True, slots=True)
class ElementUnits:
    """Units of deformation, force and stiffness of an element."""

    deformation: str
    force: str
    stiffness: str


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """Describing function over the deformation, (m,), and the half width of its 95 % band.

    The half widths have the same shape; None if no parameter is unknown, or if one that matters is
    not determined; `undetermined` names the latter.
    """

    stiffness: ComplexArray
    real_half: RealArray | None
    imaginary_half: RealArray | None
    undetermined: tuple[str, ...] = ()


def gather_motions(tests: Mapping[str, UpdateResult]) -> tuple[tuple[Motion, ...], tuple[str, ...]]:
    """Return the largest motion of each element in each test, and notes on missing ones."""
    found: list[Motion] = []
    notes = []
    for name, result in tests.items():
        data, model = result.data, result.model
        if not isinstance(data, FRF) or not model.nonlinear or data.level is None:
            continue
        frf = data.select(lines=result.lines)
        try:
            motions = LevelModel.of(model, frf, frf.freq, result.options).motions()
        except UpdynError as error:
            notes.append(f"The motion in test {name!r} could not be computed: {error}")
            continue
        for element, motion in zip(model.nonlinear, motions, strict=True):
            found.append(Motion(name or data.level_text, element, *motion))
    return tuple(found), tuple(notes)


def find_units(local: LocalElement) -> ElementUnits:
    """Return the units of an element from the degrees of freedom that it acts on."""
    return ElementUnits(*(choose_unit(unit, local.rotates) for unit in ("m", "N", "N/m")))


def describe_element(
    result: UpdateResult, name: str, amplitudes: RealArray, freq: float
) -> Described:
    """Return the describing function of an element at amplitudes (m,), with its band.

    The band is that of the covariance of the unknowns, to first order.
    """
    element = result.model.nonlinear[name].element
    omega = np.full(len(amplitudes), 2.0 * np.pi * freq)
    N, slopes = describe_first_harmonic(element, amplitudes, omega, BALANCE.samples)
    columns, at = [], []
    for i, p in enumerate(result.parameters):
        if p.of_element and p.group == name:
            columns.append(list(list_parameters(element)).index(p.quantity))
            at.append(i)
    if not at:
        return Described(N, None, None)
    J = slopes[:, columns]
    covariance = np.array(result.covariance)[np.ix_(at, at)]
    values = np.array([result.values[result.parameters[i].name] for i in at])
    is_open = ~np.isfinite(np.diag(covariance))
    matters = np.abs(J * values) > REPORT_COMPUTATION.visible_share * np.abs(N)[:, None]
    names = [result.parameters[i].name for i in at]
    undetermined = tuple(names[k] for k in np.flatnonzero(is_open & matters.any(axis=0)))
    if undetermined:
        return Described(N, None, None, undetermined)
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    quantile = interval_quantile(_BAND, result.noise.get("degrees_of_freedom"))
    halves = [
        quantile * np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", part, covariance, part), 0.0))
        for part in (J.real, J.imag)
    ]
    return Described(N, *halves)


def follow_loop(local: LocalElement, amplitude: float, freq: float) -> tuple[RealArray, RealArray]:
    """Return deformation and force over one period of harmonic motion, first point repeated."""
    tau = 2.0 * np.pi * np.arange(BALANCE.samples) / BALANCE.samples
    u, v = amplitude * np.cos(tau), -amplitude * 2.0 * np.pi * freq * np.sin(tau)
    force = LineForces.of(local.element, u[None], v[None]).force[0]
    return np.append(u, u[0]), np.append(force, force[0])
