"""`mounted`: a drive train on a structure, by nodes and axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from updyn.elements.constraints import about_axis, constrain, join
from updyn.elements.drivetrain.pieces import whole
from updyn.errors import ModelError, suggest
from updyn.model import Model

__all__ = ["mounted"]


def mounted(
    drive: Model, structure: Model, at: Mapping[int, tuple[int, Sequence[float]]], title: str = ""
) -> Model:
    """Couple a drive train to a structure: shafts of the one turn with nodes of the other.

    A load that the structure carries, a wheel bolted to it, a motor's housing (`housing`) that
    stands on it: each is a node of the train whose rotation is that of a structure node about an
    axis.

    Parameters
    ----------
    drive : Model
        From `drivetrain`, DOFs ``node:RZ``.
    structure : Model
        With rotations at the nodes used (those of a solid by `rigid_link`). Its node numbers must
        not be the train's.
    at : mapping of int to (int, sequence of float)
        For each node of the train: node of the structure, and axis in that node's own system, shape
        (3,), any length. A positive rotation of the train is right-handed about it.
    title : str
        For the record; None stated: that of the structure.

    Returns
    -------
    Model
        All groups of both; the DOFs of the structure, then those of the train that were not
        coupled.

    Raises
    ------
    ModelError
        If the two share a DOF or a group name, a node is not in the train, or an axis is not
        usable.
    DofError
        If a node of the structure lacks a rotation that the axis needs.
    """
    if not isinstance(at, Mapping) or not at:
        raise ModelError(
            "mounted: expected {node of the train: (node of the structure, axis)} with one entry or"
            " more"
        )
    shared = [str(d) for d in drive.dofs if d in structure.dofs]
    if shared:
        raise ModelError(
            f"mounted: {', '.join(shared[:3])} {'is' if len(shared) == 1 else 'are'} in the train"
            " and in the structure; number the nodes of the train otherwise"
        )
    nodes = [str(d.node) for d in drive.dofs]
    equations = []
    for node, place in at.items():
        if str(whole("mounted", "node", node)) not in nodes:
            raise ModelError(
                f"mounted: the train has no DOF {node}:RZ (held, or it follows another by a rigid"
                f" ratio: see keep); {suggest(str(node), nodes)}"
            )
        if not isinstance(place, tuple | list) or len(place) != 2:
            raise ModelError(
                f"mounted: node {node}: {place!r}; expected (node of the structure, axis)"
            )
        equations.append(
            about_axis(f"{node}:RZ", whole("mounted", f"node {node} on", place[0]), place[1])
        )
    return constrain(join([structure, drive], title=title or structure.title), equations)
