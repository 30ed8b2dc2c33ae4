"""Classical criteria, based on mode shapes instead of parameters, for comparison.

They select responses for the modes in the band, and the references with the largest driving-point
residues.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.shapes import find_moving
from updyn.errors import DataError
from updyn.planning.criteria import Criterion, Planning
from updyn.planning.layout import Layout
from updyn.updating.problem.optimal_design import DesignScore, exchange_items, select_greedily

__all__ = [
    "DrivingPointResidue",
    "EffectiveIndependence",
    "LeastMac",
    "driving_point_residues",
    "effective_independence",
    "least_mac",
]


class EffectiveIndependence(Criterion):
    """Responses that keep the mode shapes linearly independent (Kammer 1991)."""

    source = "Kammer, J. Guidance, Control and Dynamics 14 (1991) 251-259"

    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select responses by effective independence."""
        rows = effective_independence(_find_observed_shapes(planning), n_responses)
        return Layout(tuple(rows), _select_references(planning, n_references))


class LeastMac(Criterion):
    """Responses with the smallest MAC between different modes."""

    source = "Carne & Dohrmann, Proc. IMAC XIII (1995) 927-933"

    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select responses by the largest MAC off the diagonal."""
        rows = least_mac(_find_observed_shapes(planning), n_responses)
        return Layout(tuple(rows), _select_references(planning, n_references))


class DrivingPointResidue(Criterion):
    """Responses with the largest mean driving-point residue."""

    source = "Kientzy, Richardson & Blakely, Sound and Vibration 23 (6) (1989) 16-23"

    def choose(self, planning: Planning, n_responses: int, n_references: int) -> Layout:
        """Select responses by driving-point residue."""
        residue = driving_point_residues(planning.response_shapes, planning.modes.frequency)
        return Layout(
            _find_largest(residue, n_responses), _select_references(planning, n_references)
        )


def _find_observed_shapes(planning: Planning) -> RealArray:
    """Return the target modes at the candidate responses, without those at rest."""
    shapes = planning.response_shapes
    move = find_moving(shapes, planning.modes.shapes)
    if not move.any():
        raise DataError("no mode in the band moves at the candidate responses")
    return np.asarray(shapes[:, move])


def _select_references(planning: Planning, count: int) -> tuple[int, ...]:
    residue = driving_point_residues(planning.reference_shapes, planning.modes.frequency)
    return _find_largest(residue, count)


def _find_largest(values: RealArray, count: int) -> tuple[int, ...]:
    return tuple(np.argsort(-values, kind="stable")[:count].tolist())


def driving_point_residues(shapes: RealArray, frequency: RealArray) -> RealArray:
    """Return the sum over modes of the driving-point residue phi^2 / (2 omega), in s/kg.

    `shapes` are normalised by mass, in 1/sqrt(kg); `frequency` is in Hz.
    """
    return np.asarray((shapes**2 / (4.0 * np.pi * frequency)).sum(axis=1))


def effective_independence(shapes: RealArray, count: int) -> list[int]:
    """Return DOFs, ascending, after deletion of those that contribute least to the rank.

    `shapes` has shape (n, n_modes); at most `count` modes are used.
    """
    # The contribution of a DOF is its diagonal entry of phi (phi^T phi)^-1 phi^T (Kammer 1991, eq.
    # 15), here from orthonormal columns of phi.
    phi = shapes[:, : min(count, shapes.shape[1])]
    remaining = np.arange(len(phi))
    while len(remaining) > count:
        basis = np.linalg.qr(phi[remaining])[0]
        remaining = np.delete(remaining, int(np.argmin((basis**2).sum(axis=1))))
    return [int(i) for i in remaining]


@dataclass(frozen=True, slots=True)
class _LargestMac(DesignScore):
    """Minus the largest MAC between different modes, from the sum of phi_i phi_i^T over DOFs."""

    def score(self, information: RealArray) -> RealArray:
        n = information.shape[-1]
        size = np.einsum("...pp->...p", information)
        both = np.maximum(size[..., :, None] * size[..., None, :], np.finfo(float).tiny)
        mac = information**2 / both
        return np.asarray(-mac[..., ~np.eye(n, dtype=np.bool_)].max(axis=-1))


def least_mac(shapes: RealArray, count: int) -> list[int]:
    """Return DOFs, ascending, with the smallest maximum MAC between different modes."""
    # Greedy from the best pair, then by exchange.
    if shapes.shape[1] < 2:
        raise DataError("MAC requires at least two modes in the band, found one")
    unit = shapes / np.linalg.norm(shapes, axis=0)
    items = unit[:, :, None] * unit[:, None, :]
    criterion = _LargestMac()
    if count == 1 or len(items) == 1:
        return [int(np.argmax(criterion.score(items)))]
    best = [criterion.score(item + items) for item in items]
    first, second = np.unravel_index(int(np.argmax(best)), (len(items), len(items)))
    pair = [int(first), int(second)]
    remaining = np.setdiff1d(np.arange(len(items)), pair)
    further, total = select_greedily(
        items[remaining], items[pair].sum(axis=0), count - 2, criterion
    )
    chosen = [*pair, *remaining[further].tolist()]
    return sorted(exchange_items(items, total, chosen, criterion))
