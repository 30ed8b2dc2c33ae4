"""The ``.npz`` archive written by ``System.save`` of SDynPy, identified by its names.

The fields are those of SDynPy 0.23. ``transformation`` is the matrix from states to coordinates,
the identity unless the system was reduced or transformed; ``coordinate`` has pairs of node and
direction, 1 to 6 for X Y Z RX RY RZ, negative for the opposite sense.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from updyn.arrays import IndexArray, IntArray, NumberArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.items import as_reals, check_names, locate_errors
from updyn.model import Group, Model

__all__ = ["FIELDS", "is_system", "system_model"]

FIELDS = ("mass", "stiffness", "damping", "transformation", "coordinate", "enforce_symmetry")
_NEEDED = FIELDS[:5]


def is_system(names: Mapping[str, object]) -> bool:
    """Return whether the names of an archive are all or nearly all of those of a system."""
    return "coordinate" in names and sum(name in names for name in _NEEDED) >= 3


def system_model(arrays: Mapping[str, NumberArray], path: str | Path) -> Model:
    """Build a model of one group "model" from the arrays of a system, in units of the file (SI)."""
    # A state gets the label of the coordinate that is equal to it; for a negative coordinate the
    # state changes sign. Other states (modal, Craig-Bampton) are refused.
    check_names(arrays, FIELDS, path, "SDynPy System")
    missing = [name for name in _NEEDED if name not in arrays]
    if missing:
        raise FormatError(f"SDynPy System: no {missing[0]!r}; expected {', '.join(_NEEDED)}", path)
    nodes, directions = _coordinates(arrays["coordinate"], path)
    K, M, C, T = (
        np.atleast_2d(as_reals(arrays[n], n, path))
        for n in ("stiffness", "mass", "damping", "transformation")
    )
    size = K.shape[0]
    for name, found, expected in (
        ("stiffness", K.shape, (size, size)),
        ("mass", M.shape, (size, size)),
        ("damping", C.shape, (size, size)),
        ("transformation", T.shape, (len(nodes), size)),
    ):
        if found != expected:
            raise FormatError(f"SDynPy System: {name} of shape {found}, expected {expected}", path)
    row = _coordinate_of_state(T, nodes, directions, path)
    sign = np.sign(directions[row]) * T[row, np.arange(size)]
    turned = sign[:, None] * sign[None, :]
    with locate_errors(path, "SDynPy System"):
        group = Group(K * turned, M * turned, viscous=C * turned if C.any() else None)
        return Model.from_groups(
            {"model": group},
            DofSet.from_arrays(nodes[row], np.abs(directions[row]) - 1),
            title=Path(path).stem,
        )


def _coordinates(given: NumberArray, path: str | Path) -> tuple[IntArray, IntArray]:
    if given.dtype.names != ("node", "direction") or given.ndim != 1:
        raise FormatError(
            f"coordinate: found {given.dtype} of shape {given.shape}; expected one row of pairs of"
            " node and direction",
            path,
        )
    directions = given["direction"].astype(np.int64)
    bad = np.flatnonzero((directions == 0) | (np.abs(directions) > 6))
    if bad.size:
        node, direction = given[int(bad[0])]
        raise FormatError(
            f"coordinate {int(bad[0]) + 1}: node {node} has direction {direction}; expected 1..6"
            " for X, Y, Z, RX, RY, RZ, negative for the opposite sense",
            path,
        )
    if given.size and given["node"].max() > np.iinfo(np.int64).max:
        raise FormatError(f"coordinate: node {given['node'].max()} is too large", path)
    return given["node"].astype(np.int64), directions


def _coordinate_of_state(
    T: RealArray,
    nodes: IntArray,
    directions: IntArray,
    path: str | Path,
) -> IndexArray:
    """Return for each state the first coordinate equal to it, with either sign."""
    # The identity part of a reduction is computed, so its last digits may be wrong.
    ones, zeros = np.abs(np.abs(T) - 1.0) < 1e-12, np.abs(T) < 1e-12
    alone = (ones.sum(axis=1) == 1) & ((ones | zeros).all(axis=1))
    pure = ones & alone[:, None]
    if not pure.any(axis=0).all():
        unmatched = int(np.argmin(pure.any(axis=0)))
        raise FormatError(
            f"SDynPy System: state {unmatched + 1} of {T.shape[1]} is not a coordinate but part"
            " of several (a modal or Craig-Bampton reduction); save the unreduced system, or a"
            " reduction that keeps coordinates (Guyan, dynamic)",
            path,
        )
    row: IndexArray = np.argmax(pure, axis=0)
    dependent = np.setdiff1d(np.arange(len(T)), row)
    if dependent.size:
        first = DofSet.from_arrays(nodes[dependent[:1]], np.abs(directions[dependent[:1]]) - 1)[0]
        warnings.warn(
            f"{path}: {dependent.size} coordinates that are combinations of the {T.shape[1]} states"
            f" are ignored; the first is {first}",
            UpdynWarning,
            stacklevel=4,
        )
    return row
