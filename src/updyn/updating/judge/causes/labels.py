"""Labels of degrees of freedom without signs."""

from __future__ import annotations

from updyn.dofs import DIRECTIONS, DofSet
from updyn.frf import FRF

__all__ = ["list_response_labels", "list_unsigned_labels"]


def list_unsigned_labels(dofs: DofSet) -> list[str]:
    """Return the labels of DOFs without signs."""
    pairs = zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True)
    return [f"{node}:{DIRECTIONS[axis]}" for node, axis in pairs]


def list_response_labels(frf: FRF) -> list[str]:
    """Return the labels of the responses without signs."""
    return list_unsigned_labels(frf.responses)
