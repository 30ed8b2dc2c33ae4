"""Clusters of close modes, whose shapes are compared as subspaces.

A coupling by a share e of their frequency rotates the shapes of two close modes by 1/2 atan(2 e /
gap). Close modes are therefore compared by the principal angles between the spans of their shapes
(Bjorck & Golub, Math. Comp. 27 (1973) 579-594).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from updyn.arrays import BoolArray, IndexArray, NumberArray, RealArray
from updyn.correlation.settings import MODE_PAIRING
from updyn.correlation.shapes import ModePairs, compute_cosines, mac, orthonormalise, unit_shapes

__all__ = [
    "PairedModes",
    "PairingRule",
    "Subspace",
    "cluster_modes",
    "pair_clusters",
    "pair_frequencies",
    "principal_vectors",
]

Array = RealArray

#: The set with close modes, by whether computed and measured modes are close.
_CLOSE_IN = {(True, True): "both", (True, False): "computed", (False, True): "measured"}


@dataclass(frozen=True, slots=True, eq=False)
class Subspace:
    """Close modes whose shapes are compared by the subspaces that they span.

    Attributes
    ----------
    computed, measured : ndarray of int
        Indices of the computed and the measured modes, ascending. Their counts may differ.
    frequency_computed, frequency_measured : ndarray of float
        Their natural frequencies in Hz.
    cosines : ndarray of float
        Cosines of the principal angles between the two spans at the sensors, descending; their
        number is the dimension of the smaller span.
    mac : float
        Subspace MAC: the squared cosine of the n-th smallest principal angle, for n pairs. It is
        the lowest MAC that a shape of the smaller span has with the best combination of the shapes
        of the other (S2MAC for a mode and a plane, W. D'Ambrogio & A. Fregolent, Mech. Syst.
        Signal Process. 17 (2003) 599-610), and does not depend on the basis.
    mac_single : float
        Lowest MAC of single shapes in the one-to-one pairing with the largest sum of MAC. It
        depends on the basis.
    close : str
        The set in which the modes are close: ``"computed"``, ``"measured"`` or ``"both"``.
    vacuous : bool
        Whether one of the spans contains every shape at the sensors. The subspace MAC is then 1
        for any shapes.
    """

    computed: IndexArray
    measured: IndexArray
    frequency_computed: Array
    frequency_measured: Array
    cosines: Array
    mac: float
    mac_single: float
    close: str
    vacuous: bool

    def __repr__(self) -> str:
        return f"Subspace({self.text()})"

    @property
    def blocks(self) -> list[tuple[int, int, int, int]]:
        """First and last computed, first and last measured mode of each block of adjacent modes."""
        rows, columns = _find_runs(self.computed), _find_runs(self.measured)
        return [(*row, *column) for row in rows for column in columns]

    def text(self) -> str:
        """Return the modes, the subspace MAC and its limitations as text."""
        text = (
            f"measured {_format_frequencies(self.frequency_measured)} and computed"
            f" {_format_frequencies(self.frequency_computed)}: subspace MAC {self.mac:.3f}, MAC of"
            f" single shapes at best {self.mac_single:.3f}"
        )
        other = {"measured": self.frequency_computed, "computed": self.frequency_measured}
        if self.close in other:
            difference = other[self.close]
            text += f"; only the {self.close} modes are close"
            if len(difference) > 1:
                spread = 100.0 * (difference.max() / difference.min() - 1.0)
                text += f", the others are {spread:.2g} % apart"
        if self.vacuous:
            text += "; 1 for any shapes, as there are no more sensors than modes"
        return text


def _find_runs(modes: IndexArray) -> list[tuple[int, int]]:
    """Return the first and last of each run of consecutive numbers."""
    parts = np.split(modes, np.flatnonzero(np.diff(modes) > 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]


def _format_frequencies(frequency: Array) -> str:
    return ", ".join(f"{f:#.5g}".rstrip(".") for f in frequency) + " Hz"


@dataclass(frozen=True, slots=True)
class PairingRule:
    """Limits of the pairing of modes: relative differences of frequency, and MAC.

    `gate` limits the difference of a pair, `close` that in a cluster; `least_mac` is the least MAC
    of a pair of equal frequencies.
    """

    gate: float = field(default_factory=lambda: MODE_PAIRING.frequency_gate)
    least_mac: float = field(default_factory=lambda: MODE_PAIRING.least_mac)
    close: float = field(default_factory=lambda: MODE_PAIRING.close_frequencies)


@dataclass(frozen=True, slots=True, eq=False)
class PairedModes:
    """Pairs of modes, and the subspaces of close modes, both by ascending measured frequency."""

    pairs: ModePairs
    subspaces: tuple[Subspace, ...]

    @property
    def computed_modes(self) -> IndexArray:
        """Computed modes in a pair or a subspace."""
        return np.unique(np.concatenate([self.pairs.first, *(s.computed for s in self.subspaces)]))

    def renumber(self, kept: BoolArray) -> PairedModes:
        """Return the pairs for a subset of the computed modes, which contains `computed_modes`."""
        number = np.cumsum(kept) - 1
        subspaces = [replace(s, computed=number[s.computed]) for s in self.subspaces]
        return PairedModes(self.pairs._replace(first=number[self.pairs.first]), tuple(subspaces))


def cluster_modes(frequency: Array, close: float | None = None) -> list[IndexArray]:
    """Divide modes into clusters of close frequencies, by ascending frequency.

    `close` is the largest relative difference between the highest and the lowest frequency of a
    cluster; too large groups are divided at their largest gap.
    """
    close = MODE_PAIRING.close_frequencies if close is None else close
    found: list[IndexArray] = []
    waiting = [np.argsort(frequency, kind="stable")]
    while waiting:
        part = waiting.pop()
        f = frequency[part]
        if f[-1] <= f[0] * (1.0 + close):
            found.append(np.sort(part))
            continue
        step = np.diff(f)
        infinite = np.where(step > 0, np.inf, 0.0)  # from 0 Hz
        gap = np.divide(step, f[:-1], out=infinite, where=f[:-1] > 0)
        cut = int(np.argmax(gap)) + 1
        waiting += [part[cut:], part[:cut]]
    return found


def pair_clusters(
    a: NumberArray, b: NumberArray, frequency: tuple[Array, Array], rule: PairingRule
) -> PairedModes:
    """Pair computed (a) and measured (b) modes one to one, and those of clusters by subspace.

    The MAC of a pair with modes in a subspace is that of the subspace.
    """
    clusters = cluster_modes(frequency[0], rule.close), cluster_modes(frequency[1], rule.close)
    values = mac(a, b)
    difference, limit = _differences(frequency, rule.gate)
    similarity, most = values.copy(), {}
    bases = [_compute_bases(shapes, of) for shapes, of in zip((a, b), clusters, strict=True)]
    for i, one in enumerate(clusters[0]):
        for j, two in enumerate(clusters[1]):
            if len(one) == len(two) == 1:
                continue
            block = np.ix_(one, two)
            if (difference[block] > limit[block]).all():
                continue
            ranks = bases[0][i].shape[1], bases[1][j].shape[1]
            squares = compute_cosines(bases[0][i], bases[1][j]) ** 2
            shared = squares[squares >= rule.least_mac]
            similarity[block] = shared.mean() if len(shared) else squares[0]
            largest = max(len(one), len(two)) - max(ranks) + len(shared)
            most[i, j] = min(len(one), len(two), largest)
    first, second = _assign_pairs(similarity, difference, limit, rule)
    membership = _membership(clusters[0]), _membership(clusters[1])
    kept = _limit_pairs(most, membership, first, second, difference)
    first, second = first[kept], second[kept]
    pairs = ModePairs(first, second, values[first, second])
    return _add_subspaces(pairs, (a, b), frequency, clusters, values)


def pair_frequencies(frequency: tuple[Array, Array], gate: float) -> ModePairs:
    """Pair computed and measured modes by frequency alone, in ascending order; MAC is nan.

    The pairs have the least sum of the squared logarithms of their frequency ratios, which keeps
    the order. A measured mode without a computed one within the gate has no pair.
    """
    difference, limit = _differences(frequency, gate)
    both = (frequency[0][:, None] > 0) & (frequency[1] > 0)
    ratio = np.divide(frequency[0][:, None], frequency[1], out=np.ones(both.shape), where=both)
    score = 1.0 - np.log(ratio) ** 2 / (4.0 * np.log1p(gate) ** 2)
    first, second = _assign(score, difference <= limit)
    return ModePairs(first, second, np.full(len(first), np.nan))


def _differences(frequency: tuple[Array, Array], gate: float) -> tuple[Array, Array]:
    """Return differences of frequency and their limits for pairs, both in Hz."""
    one, two = frequency[0][:, None], frequency[1]
    return np.abs(one - two), gate * np.minimum(one, two)


def _compute_bases(shapes: NumberArray, clusters: Sequence[IndexArray]) -> list[NumberArray]:
    """Return an orthonormal basis of the shapes of each cluster."""
    unit = unit_shapes("shapes", shapes)
    return [orthonormalise(unit[:, cluster]) for cluster in clusters]


def _membership(clusters: Sequence[IndexArray]) -> IndexArray:
    number = np.zeros(sum(map(len, clusters)), dtype=np.intp)
    for k, cluster in enumerate(clusters):
        number[cluster] = k
    return number


def _assign_pairs(
    similarity: Array, difference: Array, limit: Array, rule: PairingRule
) -> tuple[IndexArray, IndexArray]:
    """Return the pairs with the largest total score, by ascending measured frequency."""
    share = np.divide(difference, limit, out=np.zeros_like(difference), where=limit > 0)
    score = similarity - MODE_PAIRING.frequency_weight * share**2
    return _assign(score, (difference <= limit) & (score >= rule.least_mac))


def _assign(score: Array, is_allowed: BoolArray) -> tuple[IndexArray, IndexArray]:
    """Return the allowed pairs with the largest total score, by the second of each."""
    from scipy.optimize import linear_sum_assignment

    first, second = linear_sum_assignment(np.where(is_allowed, score, 0.0), maximize=True)
    keep = is_allowed[first, second]
    first, second = first[keep], second[keep]
    order = np.argsort(second, kind="stable")
    return first[order], second[order]


def _limit_pairs(
    most: dict[tuple[int, int], int],
    membership: tuple[IndexArray, IndexArray],
    first: IndexArray,
    second: IndexArray,
    difference: Array,
) -> BoolArray:
    """Return which pairs to keep: between two clusters, at most as many as common directions."""
    # The basis of a cluster is arbitrary, so any of its pairs can be dropped; pairs with the
    # largest difference of frequency are.
    keep = np.ones(len(first), dtype=bool)
    blocks = list(zip(membership[0][first].tolist(), membership[1][second].tolist(), strict=True))
    for block in set(blocks) & set(most):
        inside = np.flatnonzero([one == block for one in blocks])
        order = inside[np.argsort(difference[first[inside], second[inside]], kind="stable")]
        keep[order[most[block] :]] = False
    return keep


def _add_subspaces(
    pairs: ModePairs,
    shapes: tuple[NumberArray, NumberArray],
    frequency: tuple[Array, Array],
    clusters: tuple[list[IndexArray], list[IndexArray]],
    values: Array,
) -> PairedModes:
    # Clusters that are connected by pairs, directly or through others, form one subspace.
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(clusters[0]), len(clusters[1])
    member = _membership(clusters[0]), _membership(clusters[1])
    edges = member[0][pairs.first], n[0] + member[1][pairs.second]
    graph = coo_array((np.ones(len(pairs.mac)), edges), shape=(sum(n), sum(n)))
    _, group = connected_components(graph, directed=False)
    of_mode = group[member[0]], group[n[0] + member[1]]
    criterion, found = pairs.mac.copy(), []
    for number in dict.fromkeys(of_mode[1][pairs.second].tolist()):
        inside = of_mode[1][pairs.second] == number
        which = np.flatnonzero(of_mode[0] == number), np.flatnonzero(of_mode[1] == number)
        if len(which[0]) == len(which[1]) == 1:
            continue
        close = [bool(np.bincount(of[at]).max() > 1) for of, at in zip(member, which, strict=True)]
        member_shapes = shapes[0][:, which[0]], shapes[1][:, which[1]]
        a, b = (orthonormalise(unit_shapes("shapes", one)) for one in member_shapes)
        cosines, single = compute_cosines(a, b), values[np.ix_(*which)]
        cosines.flags.writeable = False
        subspace = Subspace(
            *which,
            frequency[0][which[0]],
            frequency[1][which[1]],
            cosines,
            float(cosines[min(int(inside.sum()), len(cosines)) - 1] ** 2),
            float(single[linear_sum_assignment(single, maximize=True)].min()),
            _CLOSE_IN[close[0], close[1]],
            max(a.shape[1], b.shape[1]) >= len(a),
        )
        criterion[inside] = subspace.mac
        found.append(subspace)
    return PairedModes(pairs._replace(mac=criterion), tuple(found))


def principal_vectors(a: NumberArray, b: NumberArray, n: int) -> tuple[NumberArray, NumberArray]:
    """Return orthonormal vectors, (N, n), of the n smallest principal angles between two spans."""
    one, two = orthonormalise(unit_shapes("shapes", a)), orthonormalise(unit_shapes("shapes", b))
    left, _, right = np.linalg.svd(one.conj().T @ two, full_matrices=False)
    return one @ left[:, :n], two @ right[:n].conj().T
