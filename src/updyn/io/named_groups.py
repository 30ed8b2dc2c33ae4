"""The ways in which people store a model's matrices by part, brought to one: a mapping of group name to K, M, C.

Besides ``groups.NAME.K`` (`updyn.io.named`): a struct array ``groups`` with fields name, K, M, C,
loss_factor; and ``K``, ``M``, ``C`` as structs themselves, a field for each part (``K.shaft``,
``M.shaft``), and so ``loss_factor`` and the other damping. Labels may be ``dof_ref``, node and
direction 0 to 5, as ansys-mapdl-reader returns them and the ``MK_model`` of pyFBS keeps them. The
matrices that ansys-mapdl-reader returns are upper triangles, which are refused with that word.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.errors import FormatError
from updyn.io.damping import DAMPING
from updyn.io.items import Items, kind_of, number, text, whole

__all__ = ["refuse_triangle", "with_groups"]

_MATRICES = ("K", "M", "C")


def with_groups(items: Items, path: str | Path) -> Items:
    """Return the items with parts as ``groups`` and labels as ``dofs``.

    Raises
    ------
    FormatError
        If two ways are mixed, a part has no name or stands twice, or ``dof_ref`` is no table of
        node and direction.
    """
    out = dict(items)
    if "dof_ref" in out:
        if "dofs" in out:
            raise FormatError("holds both 'dofs' and 'dof_ref'; expected one of them", path)
        table = whole(out.pop("dof_ref"), "dof_ref", path)
        if table.ndim != 2 or table.shape[1] != 2 or not np.isin(table[:, 1], range(6)).all():
            raise FormatError(
                f"dof_ref: found numbers of shape {table.shape}; expected (N, 2): node, and"
                " direction 0..5 for X, Y, Z, RX, RY, RZ; a table with directions 1..6 is called"
                " dofs",
                path,
            )
        out["dofs"] = table + np.array([0, 1])
    if isinstance(out.get("groups"), list):
        out["groups"] = _from_array(out["groups"], path)
    split = [key for key in _MATRICES if isinstance(out.get(key), Mapping)]
    if not split:
        return out
    if "groups" in out or any(key in out and key not in split for key in _MATRICES):
        other = next(key for key in ("groups", *_MATRICES) if key in out and key not in split)
        raise FormatError(
            f"{split[0]} is a struct, with a matrix for each part, and {other} is not", path
        )
    groups: dict[str, dict[str, Any]] = {}
    for key in split:
        for name, part in out.pop(key).items():
            groups.setdefault(name, {})[key] = part
    for key in DAMPING:
        for name, value in _by_part(out, key, path).items():
            if name not in groups:
                raise FormatError(f"{key}: no part {name!r} in {', '.join(split)}", path)
            groups[name][key] = value
    return {**out, "groups": groups}


def _by_part(out: dict[str, Any], key: str, path: str | Path) -> dict[str, Any]:
    given = out.pop(key, {})
    if not isinstance(given, Mapping):
        found = "one table" if key == "loss_table" else f"{number(given, key, path):g}"
        raise FormatError(
            f"{key} is {found} for several parts; expected a struct with one for each", path
        )
    return dict(given)


def _from_array(parts: list[Any], path: str | Path) -> dict[str, Any]:
    groups: dict[str, Any] = {}
    for i, part in enumerate(parts, 1):
        if not isinstance(part, Mapping):
            raise FormatError(f"groups: expected one struct a group, found {kind_of(parts)}", path)
        if "name" not in part:
            raise FormatError(
                f"groups({i}) has no field 'name'; it has {', '.join(map(str, part))}", path
            )
        name = text(part["name"], f"groups({i}).name", path)
        if name in groups:
            raise FormatError(f"group {name!r} stands twice", path)
        # An element of a struct array has all fields of the others; those that it does not need are
        # empty.
        groups[name] = {key: value for key, value in part.items() if not _empty(value)}
    return groups


def _empty(value: Any) -> bool:
    return 0 in value.shape if sp.issparse(value) or isinstance(value, np.ndarray) else value == []


def refuse_triangle(matrix: Any, name: str, path: str | Path) -> None:
    """Refuse one triangle of a matrix, which is what programs store of a symmetric one.

    Raises
    ------
    FormatError
        If all entries off the diagonal are on one side of it.
    """
    entry = sp.coo_array(matrix)
    if entry.ndim != 2 or entry.shape[0] != entry.shape[1]:
        return
    upper = bool((entry.data[entry.row < entry.col] != 0).any())
    lower = bool((entry.data[entry.row > entry.col] != 0).any())
    if upper != lower:
        side, other = ("upper", "triu(K, 1)") if upper else ("lower", "tril(K, -1)")
        raise FormatError(
            f"{name}: holds the {side} triangle only, as programs store a symmetric matrix;"
            f" expected all of it: K + {other}' completes it",
            path,
        )
