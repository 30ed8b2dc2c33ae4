"""`sensor_masses`: the mass of each sensor as a group of its own, and as an unknown about its nominal value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import DofError, ModelError, suggest
from updyn.group import Group
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet, parameters

__all__ = ["add_sensor_masses", "sensor_group", "sensor_masses"]


def sensor_masses(
    model: Model,
    masses: Mapping[Any, float],
    *,
    prior_std: float = 0.3,
    bounds: tuple[float, float] = (0.1, 10.0),
) -> tuple[Model, ParameterSet]:
    """Put the mass of each sensor on the model and choose it as an unknown.

    A sensor, with its cable, loads the structure by a mass that is known roughly. It stays where it
    is while the forces move; of a sensor that moves from column to column of the FRF the mass is in
    other places in each, which no one model can say: use dummy masses in the test, or one test for
    each place (`updyn.update_jointly`).

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
        Of each mass as a share of its nominal value.

    Returns
    -------
    Model
        With a group ``sensor NODE`` for each.
    ParameterSet
        One unknown each, ``sensor NODE.mass``, a factor on the nominal mass; sets are added with
        ``+``.

    Raises
    ------
    ModelError
        If a mass is not a number above 0, two sensors stand on one node, the node has no
        translation, or the model has a group of that name.
    DofError
        If a label cannot be read or a node is not in the model.
    ParameterError
        If `prior_std` or `bounds` is not usable.
    """
    loaded = add_sensor_masses(model, masses)
    names = [name for name in loaded.groups if name not in model.groups]
    chosen = parameters(
        loaded, mass=names, bounds=dict.fromkeys(["mass"], bounds), prior_std={"mass": prior_std}
    )
    nominal = {sensor_group(key): float(mass) for key, mass in masses.items()}
    return loaded, chosen.with_nominal(
        {f"{name}.mass": mass for name, mass in nominal.items()}, "kg"
    )


def add_sensor_masses(model: Model, masses: Mapping[Any, float]) -> Model:
    """Return the model with the mass of each sensor, a group each.

    Parameters
    ----------
    model, masses
        As for `sensor_masses`.

    Raises
    ------
    ModelError, DofError
        As for `sensor_masses`.
    """
    if not isinstance(masses, Mapping) or not masses:
        raise ModelError(
            "sensor masses: expected a mapping of label or node to kg, with one sensor at least"
        )
    groups = dict(model.groups)
    for key, mass in masses.items():
        name = sensor_group(key)
        if (
            isinstance(mass, bool)
            or not isinstance(mass, int | float | np.floating)
            or not 0.0 < mass < np.inf
        ):
            raise ModelError(f"mass of sensor {key}: {mass!r}; expected a number above 0")
        if name in groups:
            why = (
                "two sensors on one node; give the mass of both once"
                if name not in model.groups
                else "rename it"
            )
            raise ModelError(f"sensor {key}: there is a group {name!r} already ({why})")
        groups[name] = Group(mass=_at_node(model, _node(key), float(mass)))
    return Model(groups, model.dofs, model.geometry, model.title)


def sensor_group(key: str | int | Dof) -> str:
    """Return the name of the group of a sensor's mass.

    Raises
    ------
    DofError
        If the label cannot be read.
    """
    return f"sensor {_node(key)}"


def _node(key: str | int | Dof) -> int:
    if isinstance(key, int | np.integer) and not isinstance(key, bool):
        return int(key)
    if isinstance(key, str) and key.lstrip("-").isdecimal():
        return int(key)
    if not isinstance(key, str | Dof):
        raise DofError(f"sensor {key!r}: expected a label such as '12:Z', or a node")
    return Dof.parse(key).node


def _at_node(model: Model, node: int, mass: float) -> sp.csr_array:
    at = np.flatnonzero(model.dofs.nodes == node)
    if not at.size:
        near = sorted({int(n) for n in model.dofs.nodes}, key=lambda n: abs(n - node))[:3]
        raise DofError(
            f"sensor at node {node}: the model has no such node;"
            f" {suggest(str(node), map(str, near))}"
        )
    moving = at[[not DIRECTIONS[a].startswith("R") for a in model.dofs.axes[at]]]
    if not moving.size:
        raise ModelError(
            f"sensor at node {node}: the model has no translation there that its mass could load"
        )
    return sp.csr_array((np.full(len(moving), mass), (moving, moving)), shape=(model.n_dofs,) * 2)
