"""Places of local elements: connections between two DOFs and to ground."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from updyn.candidates.location.settings import LOCATION
from updyn.errors import OptionError
from updyn.model import Model
from updyn.nonlinear.local import Place

__all__ = ["check_places", "list_places"]


def list_places(model: Model) -> dict[str, Place]:
    """Return the pairs of DOFs of one direction that a stiffness connects, and DOFs on ground.

    Raises OptionError for a model with too many.
    """
    K = model.stiffness.tocoo()
    labels = [str(dof) for dof in model.dofs]
    axes = np.array([label.partition(":")[2] for label in labels])
    size = float(np.abs(K.data).max(initial=0.0))
    is_one = (axes[K.row] == axes[K.col]) & (np.abs(K.data) > LOCATION.least_coupling * size)
    row, column, value = K.row[is_one], K.col[is_one], K.data[is_one]
    sums = np.bincount(row, value, minlength=len(labels))
    own = model.stiffness.diagonal()
    held = np.flatnonzero(np.abs(sums) > LOCATION.least_coupling * np.abs(own))
    pairs = np.unique(np.stack([row, column], axis=1)[row < column], axis=0)
    if len(pairs) + len(held) > LOCATION.most_default_places:
        raise OptionError(
            f"places: the stiffness of the model has {len(pairs) + len(held)} connections; state"
            f" the places of at most {LOCATION.most_default_places}, such as"
            " {'joint': ['1:X', '2:X']}"
        )
    found: dict[str, Place] = {}
    for i, j in pairs.tolist():
        found[f"{labels[i]} - {labels[j]}"] = [labels[i], labels[j]]
    for i in held.tolist():
        found[f"{labels[i]} - ground"] = [labels[i]]
    return found


def check_places(model: Model, places: Mapping[str, Place] | None) -> dict[str, Place]:
    """Return the places by name, by default those of `list_places`; OptionError without any."""
    if places is None:
        places = list_places(model)
    if not isinstance(places, Mapping) or not places:
        raise OptionError(
            f"places: expected degrees of freedom by name, such as {{'joint': ['1:X', '2:X']}},"
            f" found {places!r}"
        )
    return dict(places)
