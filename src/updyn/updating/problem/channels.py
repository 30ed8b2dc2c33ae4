"""Calibration factors of sensors as unknowns: s_i s_j H_ij is compared with the measurement.

A wrong sensitivity scales a whole row of the FRF, which no noise model of independent values
describes. Gaussian priors on ln s_i as in Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425, sec.
4.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import ParameterError, suggest
from updyn.frf import FRF
from updyn.updating.problem.parameters import (
    CHANNELS,
    Drive,
    Parameter,
    ParameterSet,
    check_bounds,
)

__all__ = [
    "Gains",
    "calibration",
    "check_channel",
]


def calibration(
    frf: FRF | Iterable[FRF],
    *,
    responses: str | Iterable[str | Dof] = "all",
    references: str | Iterable[str | Dof] = (),
    prior_std: float = 0.05,
    bounds: tuple[float, float] = (0.1, 10.0),
    name: str | None = None,
) -> ParameterSet:
    """Return calibration factors of sensors as unknowns.

    Join them with the unknowns of the model by ``+``. Each is a positive factor on the reading of a
    sensor: the measurement is compared with the model's FRF times the factors of its two channels.
    A factor of 1.08 means that the sensor reads 8 % too much. The updated model does not include
    the factors.

    Parameters
    ----------
    frf : FRF or iterable of FRF
        The measurement, or those of all tests.
    responses, references : "all" or iterable of str or Dof
        Response sensors and force sensors by their labels, regardless of sign. Leave out trusted
        sensors: they fix the level. Sensors with the same label in several tests share one factor.
    prior_std : float
        Standard deviation of the logarithm of each factor before the measurement: 0.05 is about 5
        %. Without a prior, only known masses would determine the common level of all sensors.
    bounds : (float, float)
        Bounds of each factor.
    name : str, optional
        If given, all selected sensors share one factor with the name ``NAME.calibration``, as for
        one roving accelerometer or hammer, or one amplifier.

    Returns
    -------
    ParameterSet
        Unknowns with the names ``5:Z.calibration`` for responses, ``5:Z.force_calibration`` for
        references.

    Raises
    ------
    ParameterError
        If a sensor is not in the measurement, no sensor is selected, or a number or the name is not
        usable.
    DofError
        If a label cannot be read.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> frf = chain.measure()
    >>> updyn.calibration(frf, prior_std=0.05).names[0]
    '2:X.calibration'
    """
    data = [frf] if isinstance(frf, FRF) or not isinstance(frf, Iterable) else list(frf)
    for one in data:
        if not isinstance(one, FRF):
            raise ParameterError(f"calibration: expected an FRF, found {type(one).__name__}")
    drives: list[Drive] = []
    for quantity, given in zip(CHANNELS, (responses, references), strict=True):
        drives += [
            Drive(label, quantity) for label in _select_sensors(data, CHANNELS[quantity], given)
        ]
    if not drives:
        raise ParameterError("calibration: no sensor is chosen")
    limits = check_bounds(bounds, "calibration: bounds")
    if name is None:
        items = [Parameter(d.group, d.quantity, 1.0, *limits, prior_std) for d in drives]
        return ParameterSet(tuple(items))
    if not isinstance(name, str) or not name.strip() or set(name) & set(".*?[]\n\t"):
        raise ParameterError(
            f"calibration: name {name!r}; expected a plain text, such as 'hammer'", key=("name",)
        )
    return ParameterSet((Parameter(name, "calibration", 1.0, *limits, prior_std, tuple(drives)),))


def _select_sensors(data: Iterable[FRF], kind: str, given: str | Iterable[str | Dof]) -> list[str]:
    known: dict[str, None] = {}
    for frf in data:
        known |= dict.fromkeys(_unsigned_labels(getattr(frf, f"{kind}s")))
    labels = list(known)
    if isinstance(given, str):
        if given != "all":
            raise ParameterError(
                f"calibration: {kind}s = {given!r}; expected 'all' or labels in a list",
                key=(f"{kind}s",),
            )
        return labels
    out = []
    for dof in given:
        label = _unsigned_label(Dof.parse(dof))
        if label not in labels:
            raise ParameterError(
                f"calibration: {dof} is no {kind} of the measurement; {suggest(label, labels)}",
                key=(f"{kind}s",),
            )
        out.append(label)
    return out


def _unsigned_label(dof: Dof) -> str:
    return f"{dof.node}:{dof.direction}"


def _unsigned_labels(dofs: DofSet) -> list[str]:
    return list(map(_unsigned_label, dofs))


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Powers of the unknowns in the factors of responses (n, n_i) and references (n, n_j)."""

    rows: RealArray
    columns: RealArray

    @classmethod
    def find(cls, parameters: ParameterSet, frf: FRF) -> Gains | None:
        """Return the calibration factors of some data; None if no unknown is one."""
        if not any(p.is_channel for p in parameters):
            return None
        tables = []
        for quantity, kind in CHANNELS.items():
            labels = _unsigned_labels(getattr(frf, f"{kind}s"))
            powers = np.zeros((len(parameters), len(labels)))
            for i, p in enumerate(parameters):
                for d in p.acts_on:
                    if d.quantity == quantity and d.group in labels:
                        powers[i, labels.index(d.group)] = d.power
            tables.append(powers)
        return cls(*tables)

    def factors(self, logs: RealArray) -> RealArray:
        """Return the factor of each channel, (n_i, n_j), for logarithms `logs`, shape (n,)."""
        return np.asarray(np.exp((logs @ self.rows)[:, None] + logs @ self.columns))

    def apply(self, logs: RealArray, H: ComplexArray, dH: ComplexArray | None) -> None:
        """Multiply H (n_f, n_i, n_j) and dH (n, n_f, n_i, n_j) by the factors, in place.

        The rows of dH for the logarithms of the factors are set here.
        """
        factors = self.factors(logs)
        H *= factors
        if dH is None:
            return
        dH *= factors
        for i in np.flatnonzero(self.rows.any(axis=1) | self.columns.any(axis=1)):
            dH[i] = H * (self.rows[i][:, None] + self.columns[i])


def check_channel(label: str, quantity: str, data: Iterable[FRF], name: str) -> None:
    """Raise if the sensor `label` of a calibration factor is in none of the tests."""
    kind = CHANNELS[quantity]
    labels: list[str] = []
    for frf in data:
        labels += _unsigned_labels(getattr(frf, f"{kind}s"))
    if label not in labels:
        raise ParameterError(
            f"unknown {name!r}: {label!r} is no {kind} of the measurement; {suggest(label, labels)}"
        )
