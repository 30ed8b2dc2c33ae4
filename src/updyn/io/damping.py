"""The damping coefficients of a group as file formats keep them: by name, a table as two rows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from updyn.errors import FormatError
from updyn.group import DAMPING, Group
from updyn.model import Model

__all__ = ["DAMPING", "plain_damping", "refuse_damping"]


def plain_damping(group: Group) -> dict[str, Any]:
    """Return the damping of a group by name; the table is two lists, lines in Hz and factors.

    Parameters
    ----------
    group : Group
        The group. What it has not is left out, but for the loss factor.
    """
    out = group.damping
    if group.loss_table is not None:
        out["loss_table"] = [group.loss_table.freq.tolist(), group.loss_table.relative.tolist()]
    return out


def refuse_damping(model: Model, path: str | Path, *able: str) -> None:
    """Refuse a model with damping that a format has no place for.

    Parameters
    ----------
    model : Model
        The model.
    path : path
        File to write.
    *able : str
        Which of `DAMPING` the format can hold.

    Raises
    ------
    FormatError
        If a group has other damping; the message names group and quantity.
    """
    for name, group in model.groups.items():
        for quantity in group.damping:
            if quantity not in able:
                raise FormatError(
                    f"group {name!r} has {quantity}, which this format has no place for; write .h5,"
                    " .npz, .mat or .toml",
                    path,
                )
