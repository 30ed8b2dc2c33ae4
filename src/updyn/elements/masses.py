"""Point masses on the DOFs of a model: trial masses and sensors, as groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import Dof
from updyn.elements.checks import check_positive, is_whole
from updyn.errors import DofError, ModelError, suggest
from updyn.group import Group
from updyn.model import Model

__all__ = ["add_masses", "add_sensor_masses", "sensor_group"]


def add_masses(model: Model, masses: Mapping[str, float], name: str = "added mass") -> Model:
    """Return the model with an additional group of masses in kg or kg m2 by DOF.

    A mass that moves in several directions is given for each.
    """
    if name in model.groups:
        raise ModelError(f"the model has a group {name!r} already")
    values = [check_positive(f"DOF {dof}", "mass", mass) for dof, mass in masses.items()]
    at = model.dofs.match(masses, "DOF of a mass").index
    return _with_group(model, name, at, np.array(values))


def add_sensor_masses(model: Model, masses: Mapping[Any, float]) -> Model:
    """Return the model with the mass of each sensor in kg, as a group ``sensor NODE`` each.

    `masses` is by label or node; each mass acts in all translations of the model at its node.
    """
    if not isinstance(masses, Mapping) or not masses:
        raise ModelError(
            "sensor masses: expected a mapping of label or node to kg, with one sensor at least"
        )
    loaded = model
    for key, mass in masses.items():
        name = sensor_group(key)
        value = check_positive(f"sensor {key}", "mass", mass)
        if name in model.groups:
            raise ModelError(f"sensor {key}: there is a group {name!r} already (rename it)")
        if name in loaded.groups:
            raise ModelError(
                f"sensor {key}: there is a group {name!r} already (two sensors on one node;"
                " give the mass of both once)"
            )
        at = _translations(model, _node(key))
        loaded = _with_group(loaded, name, at, np.full(len(at), value))
    return loaded


def sensor_group(key: str | int | Dof) -> str:
    """Return the name of the group of a sensor's mass, from its label or node."""
    return f"sensor {_node(key)}"


def _node(key: str | int | Dof) -> int:
    if is_whole(key):
        return int(key)
    if isinstance(key, str) and key.lstrip("-").isdecimal():
        return int(key)
    if not isinstance(key, str | Dof):
        raise DofError(f"sensor {key!r}: expected a label such as '12:Z', or a node")
    return Dof.parse(key).node


def _translations(model: Model, node: int) -> IndexArray:
    """Return the positions of the translations of a node among the DOFs of the model."""
    at_node = model.dofs.nodes == node
    if not at_node.any():
        nodes = np.unique(model.dofs.nodes)
        near = nodes[np.argsort(np.abs(nodes - node), kind="stable")[:3]]
        raise DofError(
            f"sensor at node {node}: the model has no such node;"
            f" {suggest(str(node), map(str, near.tolist()))}"
        )
    at = np.flatnonzero(at_node & (model.dofs.axes < 3))
    if not at.size:
        raise ModelError(
            f"sensor at node {node}: the model has no translation there that its mass could load"
        )
    return at


def _with_group(model: Model, name: str, at: IndexArray, values: RealArray) -> Model:
    M = sp.csr_array((values, (at, at)), shape=(model.n_dofs, model.n_dofs))
    return replace(model, groups={**model.groups, name: Group(mass=M)})
