"""Damping coefficients of a group in file formats: by name, the loss table as two rows."""

from __future__ import annotations

from pathlib import Path

from updyn.errors import FormatError
from updyn.group import DAMPING, Group
from updyn.model import Model

__all__ = ["DAMPING", "plain_damping", "refuse_damping"]


def plain_damping(group: Group) -> dict[str, object]:
    """Return the damping of a group by name; the table is two lists, lines in Hz and factors."""
    out = group.damping
    if group.loss_table is not None:
        out["loss_table"] = [group.loss_table.freq.tolist(), group.loss_table.relative.tolist()]
    return out


def refuse_damping(model: Model, path: str | Path, *able: str) -> None:
    """Refuse a model with damping outside `able`, the names of `DAMPING` that a format supports."""
    for name, group in model.groups.items():
        for quantity in group.damping:
            if quantity not in able:
                raise FormatError(
                    f"group {name!r} has {quantity}, which this format cannot hold; write .h5,"
                    " .npz, .mat or .toml",
                    path,
                )
