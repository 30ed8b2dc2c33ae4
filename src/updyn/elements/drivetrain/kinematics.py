"""Rigid ratios solved for the nodes that follow."""

from __future__ import annotations

from collections.abc import Iterable

from updyn.elements.drivetrain.pieces import Hold, Tie
from updyn.errors import ModelError

__all__ = ["resolve"]

_SAME = 1e-9  # of the terms of an equation: what is left of them is rounding


def resolve(
    ties: Iterable[Tie], holds: Iterable[Hold], keep: Iterable[int] = ()
) -> dict[int, dict[int, float]]:
    """Return the nodes that follow others, each as a combination of nodes that follow none.

    Gauss-Jordan elimination in the order of the train: the ratios first, then the holds, so that
    wheels whose ratios contradict each other are told from wheels that a hold stops.

    Parameters
    ----------
    ties : iterable of Tie
        The rigid ratios. One that the others imply is no contradiction.
    holds : iterable of Hold
        Nodes that cannot turn.
    keep : iterable of int
        Nodes that are not to follow.

    Returns
    -------
    dict of int to dict of int to float
        For each node that follows, coefficients by node; none: it stands still.

    Raises
    ------
    ModelError
        If ratios contradict each other, or a node to be kept has to follow.
    """
    kept = set(keep)
    known: dict[int, dict[int, float]] = {}
    # What stands on a housing (anchor) comes after what passes the motion on, and may stop it.
    for tie in sorted(ties, key=lambda t: t.anchor):
        row = _substituted(dict(zip(tie.nodes, tie.row, strict=True)), known)
        if len(row) == 1 and not tie.anchor:
            raise ModelError(
                f"{tie.what}: with the rigid ratios before it node {next(iter(row))} cannot turn:"
                " their ratios contradict each other; correct one, or give one a stiffness"
            )
        _follow(tie.what, row, tie.dependent, kept, known)
    for hold in holds:
        _follow(hold.what, _substituted({hold.node: 1.0}, known), hold.node, kept, known)
    return known


def _substituted(row: dict[int, float], known: dict[int, dict[int, float]]) -> dict[int, float]:
    total: dict[int, float] = {}
    size: dict[int, float] = {}
    for node, factor in row.items():
        for other, c in known.get(node, {node: 1.0}).items():
            total[other] = total.get(other, 0.0) + factor * c
            size[other] = max(size.get(other, 0.0), abs(factor * c))
    return {node: c for node, c in total.items() if abs(c) > _SAME * size[node]}


def _follow(
    what: str,
    row: dict[int, float],
    wanted: int,
    kept: set[int],
    known: dict[int, dict[int, float]],
) -> None:
    if not row:
        return
    free = [node for node in row if node not in kept]
    if not free:
        nodes = ", ".join(str(n) for n in sorted(row))
        raise ModelError(
            f"{what} ties node {nodes}, all of which are to be kept; leave one out of keep"
        )
    node = wanted if wanted in free else free[-1]
    known[node] = {other: -c / row[node] for other, c in row.items() if other != node}
    for follower, terms in list(known.items()):
        if node in terms:
            known[follower] = _substituted(terms, {node: known[node]})
