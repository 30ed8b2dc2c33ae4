"""Masses of sensors as groups of the model and as unknowns with their nominal values as prior."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.elements.masses import add_sensor_masses, sensor_group
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet, parameters

__all__ = ["sensor_masses"]


def sensor_masses(
    model: Model,
    masses: Mapping[Any, float],
    *,
    prior_std: float = 0.3,
    bounds: tuple[float, float] = (0.1, 10.0),
) -> tuple[Model, ParameterSet]:
    """Add the mass of each sensor to the model and return it as an unknown.

    A sensor, with its cable, loads the structure by a mass that is known only roughly. Its location
    must be the same in all columns of the FRF. If a sensor moves from column to column, no single
    model has its mass: use dummy masses in the test, or one test for each location
    (`updyn.update_jointly`).

    Parameters
    ----------
    model : Model
        The structure without sensors.
    masses : mapping of str, int or Dof to float
        Nominal mass of each sensor in kg by its label, or by its node; above 0. It acts in all
        translations that the model has at that node.
    prior_std : float
        Standard deviation of the logarithm of each mass before the measurement: 0.3 is about 30 %.
    bounds : (float, float)
        Bounds of each mass as a share of its nominal value.

    Returns
    -------
    Model
        The model with a group ``sensor NODE`` for each sensor.
    ParameterSet
        Unknowns ``sensor NODE.mass``, factors on the nominal masses; sets are joined with ``+``.

    Raises
    ------
    ModelError
        If a mass is not a number above 0, two sensors are at one node, the node has no translation,
        or the model has a group of that name.
    DofError
        If a label cannot be read or a node is not in the model.
    ParameterError
        If `prior_std` or `bounds` is not usable.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> loaded, unknowns = updyn.sensor_masses(chain.build(), {"12:X": 0.03})
    >>> unknowns.names
    ['sensor 12.mass']
    """
    loaded = add_sensor_masses(model, masses)
    added = [name for name in loaded.groups if name not in model.groups]
    chosen = parameters(loaded, mass=added, bounds={"mass": bounds}, prior_std={"mass": prior_std})
    nominal = {f"{sensor_group(key)}.mass": float(mass) for key, mass in masses.items()}
    return loaded, chosen.with_nominal(nominal, "kg")
