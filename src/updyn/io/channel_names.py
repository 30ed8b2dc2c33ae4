"""DOFs from names of channels such as ``Acc1:+X``: a point, a sign and a direction."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from updyn.dofs import Dof, DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.items import locate_errors

__all__ = ["label_channels", "warn"]

_NAME = re.compile(r"(.*):([+-]?)(R?[XYZ])")
_POINT = re.compile(r"(?:.*:)?([0-9]{1,8})")
#: First number of points that are not nodes; Nastran allows numbers up to 99999999.
_FIRST = 900_000_001


def label_channels(
    rows: list[str],
    columns: list[str],
    response_labels: Iterable[str | Dof] | None,
    reference_labels: Iterable[str | Dof] | None,
    path: str | Path,
) -> tuple[DofSet, DofSet]:
    """Return the DOFs of responses and references, from labels or from the names of channels."""
    unlabelled = (rows if response_labels is None else []) + (
        columns if reference_labels is None else []
    )
    nodes = _number_points(unlabelled)
    dofs = []
    for side, names, given in (
        ("response", rows, response_labels),
        ("reference", columns, reference_labels),
    ):
        key = f"{side}_labels"
        with locate_errors(path, f"{side}s {', '.join(names)}"):
            if given is None:
                found = DofSet(_parse_name(name, nodes, key, path) for name in names)
            else:
                found = DofSet(given)
        if len(found) != len(names):
            message = f"{key}: {len(found)} labels for {len(names)} channels: {', '.join(names)}"
            raise FormatError(message, path, key=(key,))
        dofs.append(found)
    renamed = [f"{point} = {node}" for point, node in nodes.items() if node >= _FIRST]
    if renamed:
        warn(
            path,
            f"points without a node number: {', '.join(renamed)}. To compare them with a model,"
            " state response_labels and reference_labels",
            depth=5,
        )
    return dofs[0], dofs[1]


def _number_points(names: Iterable[str]) -> dict[str, int]:
    """Return a node number by point: that in its name, such as 12 for ``12`` or ``wing:12``."""
    # Points without a number, or with that of another point, get one that no model has.
    points = list(dict.fromkeys(found[1] for name in names if (found := _NAME.fullmatch(name))))
    stated = {p: int(found[1]) for p in points if (found := _POINT.fullmatch(p))}
    counts = Counter(stated.values())
    unique = {point: node for point, node in stated.items() if counts[node] == 1}
    rest = [point for point in points if point not in unique]
    return unique | {point: node for node, point in enumerate(rest, _FIRST)}


def _parse_name(name: str, nodes: Mapping[str, int], key: str, path: str | Path) -> Dof:
    found = _NAME.fullmatch(name)
    if found is None:
        raise FormatError(
            f"channel {name!r}: expected point:direction, such as 'Acc1:+X', with a direction of X"
            f" Y Z RX RY RZ; or state {key}",
            path,
            key=(key,),
        )
    return Dof(nodes[found[1]], found[3], -1 if found[2] == "-" else 1)


def warn(path: str | Path, message: str, depth: int) -> None:
    """Warn about the content of a file; `depth` counts the calls up to the user's."""
    warnings.warn(f"{path}: {message}", UpdynWarning, stacklevel=depth + 1)
