"""``lines`` of ``[match]``: lines between the nodes of a test, for the picture of its shapes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from updyn.dofs import Dof
from updyn.errors import JobError, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching import Matching
from updyn.model import Model

__all__ = ["with_trace_lines"]

_KEY = ("match", "lines")


def with_trace_lines(
    matching: Matching, chains: Sequence[Sequence[int]], others: Collection[int]
) -> Matching:
    """Return a matching with lines along chains of nodes of the test, without those of `others`."""
    if not chains:
        return matching
    if not isinstance(matching.data, FRF):
        raise JobError("lines need measured FRFs; modes have no geometry", key=_KEY)
    nodes = {Dof.parse(row.sensor).node: Dof.parse(row.dof).node for row in matching.table}
    lines = []
    for first, second in (pair for chain in chains for pair in pairwise(chain)):
        for node in (first, second):
            if node not in nodes and node not in others:
                numbers = [str(known) for known in nodes]
                raise JobError(
                    f"lines: the test has no sensor or force at node {node};"
                    f" {suggest(str(node), numbers)}",
                    key=_KEY,
                )
        if first in nodes and second in nodes and nodes[first] != nodes[second]:
            lines.append((nodes[first], nodes[second]))
    data = matching.data
    geometry = data.geometry or _geometry_at(matching.model, list(nodes.values()))
    drawn = Geometry(geometry.nodes, geometry.xyz, lines, geometry.axes, geometry.faces)
    return replace(matching, data=replace(data, geometry=drawn))


def _geometry_at(model: Model, nodes: Sequence[int]) -> Geometry:
    """Return the positions of nodes in the model."""
    geometry = model.geometry
    if geometry is None:
        raise JobError("lines need positions; neither test nor model has any", key=_KEY)
    kept = np.isin(geometry.nodes, nodes)
    axes = None if geometry.axes is None else geometry.axes[kept]
    return Geometry(geometry.nodes[kept], geometry.xyz[kept], axes=axes)
