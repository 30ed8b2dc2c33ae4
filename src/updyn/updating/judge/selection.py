"""Selection of unknowns by column pivoting, and clusters of collinear unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import RealArray
from updyn.errors import OptionError, ParameterError
from updyn.frf import FRF
from updyn.model import Model
from updyn.text_table import format_count
from updyn.updating.fit.settings import NULL_SPACE
from updyn.updating.fit.start_problem import build_start_problem
from updyn.updating.judge.assessment import linearise_at_start
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.judge.settings import LIST_LENGTHS, SEPARATION
from updyn.updating.problem.data import Test, check_tests
from updyn.updating.problem.parameters import Drive, Parameter, ParameterSet
from updyn.updating.problem.selection import Selection

__all__ = [
    "cluster",
    "cluster_jointly",
    "collinear_clusters",
    "collinearity_index",
    "normalise_columns",
    "select",
    "select_columns",
    "select_jointly",
]


def select_columns(
    R: RealArray, names: Sequence[str], n: int | None = None, max_collinearity: float | None = None
) -> tuple[list[int], dict[int, str]]:
    """Return columns of a Jacobian by QR with column pivoting, and the reasons against the others.

    `R` is in standard deviations of the noise. Without `n`, as many columns as the noise and
    `max_collinearity` (1 / smallest singular value at unit length) allow.
    """
    limit = SEPARATION.most_collinearity if max_collinearity is None else max_collinearity
    size = np.linalg.norm(R, axis=0)
    state = _Pivoting(R, names, size)
    for _ in range(R.shape[1]):
        if not state.waiting or len(state.order) == n:
            break
        i = max(state.waiting, key=lambda j: state.length[j])
        is_requested = n is not None and state.length[i] > NULL_SPACE.rank_tolerance * size[i]
        reason = "" if is_requested else state.find_objection(i, limit)
        if reason:
            state.left_out[i] = reason
        else:
            state.take(i)
        state.waiting.remove(i)
    for i in state.waiting:
        requested = format_count(len(state.order), "unknown")
        state.left_out[i] = f"requested: {requested}; the selected ones are determined better"
    return state.order, state.left_out


class _Pivoting:
    """State of a pivoted QR factorisation: basis of selected columns, residuals of the others."""

    def __init__(self, R: RealArray, names: Sequence[str], size: RealArray) -> None:
        self.R, self.names, self.size = R, names, size
        self.rest = R.copy()
        self.basis = np.zeros((len(R), 0))
        self.order: list[int] = []
        self.left_out: dict[int, str] = {}
        self.waiting = list(range(R.shape[1]))

    @property
    def length(self) -> RealArray:
        return np.asarray(np.linalg.norm(self.rest, axis=0))

    def take(self, i: int) -> None:
        # Orthogonalise again: rounding of the earlier projections matters for nearly dependent
        # columns.
        fresh = self.rest[:, i] - self.basis @ (self.basis.T @ self.rest[:, i])
        fresh = fresh / np.linalg.norm(fresh)
        self.basis = np.column_stack([self.basis, fresh])
        self.rest = self.rest - np.outer(fresh, fresh @ self.rest)
        self.order.append(i)

    def find_objection(self, i: int, limit: float) -> str:
        """Return the reason why a column is not selected; empty if it may be."""
        if self.size[i] * NULL_SPACE.undetermined_std <= 1.0:
            known = "not at all"
            if self.size[i] > 0.0:
                known = f"only to ±{1.0 / self.size[i]:.2g}"
            return f"it hardly affects the data: even alone it would be known {known}"
        length = float(np.linalg.norm(self.rest[:, i]))
        columns = normalise_columns(self.R[:, [*self.order, i]])
        gamma = float("inf")
        if columns.shape[1] <= columns.shape[0]:
            gamma = collinearity_index(np.linalg.svd(columns, compute_uv=False))
        if gamma > limit:
            return (
                f"its effect is explained by {self.name_explanations(i)} (collinearity index"
                f" {gamma:.3g})"
            )
        if length * NULL_SPACE.undetermined_std <= 1.0:
            return (
                f"together with {self.name_explanations(i)} it would be known only to"
                f" ±{1.0 / length:.2g}"
            )
        return ""

    def name_explanations(self, i: int) -> str:
        weight = np.linalg.lstsq(
            normalise_columns(self.R[:, self.order]), self.R[:, i], rcond=None
        )[0]
        size = np.abs(weight)
        most = np.argsort(-size)[: LIST_LENGTHS.named_items]
        most = most[size[most] >= SEPARATION.least_explanation_share * size.max()]
        return ", ".join(self.names[self.order[j]] for j in most)


def collinear_clusters(
    cosine: RealArray, kinds: Sequence[str | None], threshold: float
) -> list[list[int]]:
    """Return clusters of two or more columns of one kind whose cosines all reach a threshold."""
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    by_kind: dict[str, list[int]] = {}
    for i, kind in enumerate(kinds):
        if kind is not None and np.isfinite(cosine[i, i]):
            by_kind.setdefault(kind, []).append(i)
    out = []
    for columns in by_kind.values():
        if len(columns) < 2:
            continue
        at = np.array(columns)
        distance = np.clip(1.0 - cosine[np.ix_(at, at)], 0.0, 2.0)
        distance = 0.5 * (distance + distance.T)
        np.fill_diagonal(distance, 0.0)
        label = fcluster(linkage(squareform(distance), "complete"), 1.0 - threshold, "distance")
        for c in np.unique(label):
            members = np.flatnonzero(label == c)
            if len(members) > 1:
                out.append(at[members].tolist())
    return sorted(out)


def normalise_columns(R: RealArray) -> RealArray:
    """Return a matrix with columns scaled to unit length; columns of zeros are unchanged."""
    size = np.linalg.norm(R, axis=0)
    return np.asarray(R / np.where(size > 0.0, size, 1.0))


def collinearity_index(s: NDArray[np.floating]) -> float:
    """Return the collinearity index from the singular values of unit columns; inf if singular."""
    if s[-1] <= NULL_SPACE.rank_tolerance * s[0]:
        return float("inf")
    return float(1.0 / s[-1])


#: Largest length of a list of joined group names that is written in full.
_LONG = 40


# -- public functions ------------------------------------------------------------------------------
def select(
    model: Model,
    frf: FRF,
    parameters: ParameterSet | Selection,
    n: int | Literal["rank"] | None = None,
    max_collinearity: float = SEPARATION.most_collinearity,
    *,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
) -> Selection:
    """Select, before a fit, the unknowns that the data separate; the others are held.

    Parameters
    ----------
    model : Model
        The model at the start of the unknowns.
    frf : FRF
        The measurement. The selection depends on the derivatives of the model, and on the measured
        values only through the noise.
    parameters : ParameterSet or Selection
        All unknowns that might be fitted, or the result of `cluster`.
    n : int or "rank", optional
        Number of unknowns to keep; "rank" keeps as many as there are combinations that the data
        determine above the noise. By default, the number is the largest for which the collinearity
        index is at most `max_collinearity` and each unknown, given those selected before it, is
        determined to better than a factor e (a loss factor: to better than 1).
    max_collinearity : float
        Largest collinearity index of the selected unknowns; ignored if `n` is given.
    lines, noise
        As for `updyn.update`. If the noise is unknown, 5 % of |H| and a floor of 0.1 % of the rms
        are assumed, as for `updyn check`.

    Returns
    -------
    Selection
        Pass it to `updyn.update` as its parameters.

    Raises
    ------
    InputError
        If model, data, unknowns or options are inconsistent, or the data depend on none of the
        unknowns.
    SolverError
        If the model cannot be solved at a line.

    Notes
    -----
    The Jacobian, whitened by the noise, is factorised by QR with column pivoting (Golub & Van Loan,
    Matrix Computations, 4th ed. 2013, section 5.4.2; for dynamic models Velez-Reyes & Verghese,
    Proc. IEEE Conf. Control Applications 1995, 991; Lallement & Piranda, Proc. IMAC VIII, 1990,
    579, also select one by one, but by the explained part of a residual): each next unknown is the
    one whose effect is least explained by the previous ones. An unknown that raises the
    collinearity index (Brun, Reichert & Kuensch, Water Resour. Res. 37 (2001) 1015) above its limit
    is discarded, because the index of a larger set is never smaller. Effects are those of a change
    by a factor e, or of a loss factor by 1.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> chosen = updyn.select(model, chain.measure(), updyn.parameters(model, stiffness="all"))
    >>> chosen.parameters.names
    ['part1.stiffness', 'part2.stiffness', 'part3.stiffness', 'part4.stiffness']
    """
    return select_jointly([Test(model, frf, "", lines, noise)], parameters, n, max_collinearity)


def select_jointly(
    tests: Sequence[Test],
    parameters: ParameterSet | Selection,
    n: int | Literal["rank"] | None = None,
    max_collinearity: float = SEPARATION.most_collinearity,
) -> Selection:
    """Select the unknowns that several tests together separate; see `select`.

    Parameters
    ----------
    tests : sequence of Test
        At least one; held-out data of the tests are used as data here.
    parameters, n, max_collinearity
        As for `select`.

    Returns
    -------
    Selection

    Raises
    ------
    InputError
        If models, data, unknowns or options are inconsistent, or the data depend on none of the
        unknowns.
    SolverError
        If a model cannot be solved at a line.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> halves = [frf.select(references=[r]) for r in frf.references.labels]
    >>> tests = [updyn.Test(model, h, name=n) for h, n in zip(halves, ["a", "b"], strict=True)]
    >>> chosen = updyn.select_jointly(tests, updyn.parameters(model, stiffness="all"))
    >>> len(chosen.parameters)
    4
    """
    before = Selection.of(parameters)
    given = before.parameters
    is_count = isinstance(n, int) and not isinstance(n, bool) and 1 <= n <= len(given)
    if not (n is None or n == "rank" or is_count):
        raise OptionError(
            f"select: n = {n!r}: expected a whole number from 1 to {len(given)}, 'rank' or None",
            key=("n",),
        )
    if isinstance(max_collinearity, bool) or not max_collinearity >= 1.0:
        raise OptionError(
            f"select: max_collinearity = {max_collinearity!r}: expected a number of at least 1",
            key=("max_collinearity",),
        )
    R = _whitened_jacobian(tests, before)
    count = analyse_identifiability(R, given.names).report.rank if n == "rank" else n
    order, reasons = select_columns(R, given.names, count, max_collinearity)
    if not order:
        raise ParameterError(
            f"select: of {format_count(len(given), 'unknown')} none affects the data"
        )
    selected = [given[i] for i in sorted(order)]
    left_out = dict(before.left_out)
    held = list(before.held)
    for i, reason in sorted(reasons.items()):
        left_out[given.names[i]] = reason
        held.append(given[i])
    s = np.linalg.svd(normalise_columns(R[:, order]), compute_uv=False)
    return replace(
        before,
        parameters=ParameterSet(tuple(selected)),
        order=tuple(np.array(given.names)[order].tolist()),
        left_out=left_out,
        held=tuple(held),
        singular_values=tuple(s.tolist()),
        collinearity=collinearity_index(s),
    )


def cluster(
    model: Model,
    frf: FRF,
    parameters: ParameterSet | Selection,
    threshold: float = SEPARATION.least_cosine,
    *,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
) -> Selection:
    """Link unknowns of one quantity whose effects on the data are nearly parallel.

    Parameters
    ----------
    model, frf, parameters
        As for `select`.
    threshold : float
        Least cosine between the whitened derivatives of two collinear unknowns. All pairs in a
        cluster are collinear.
    lines, noise
        As for `select`.

    Returns
    -------
    Selection
        Its merged unknowns multiply all their groups by one factor (or give them one loss factor).
        Unknowns with opposite effects, of different quantities, or with different starts are not
        joined; `remarks` lists them.

    Raises
    ------
    InputError
        If model, data, unknowns or options are inconsistent.
    SolverError
        If the model cannot be solved at a line.

    Notes
    -----
    Hierarchical clustering with complete linkage on 1 - cosine (Brun's pairwise index
    1 / sqrt(1 - cosine) is 10 at 0.99). The bounds of a merged unknown are the intersection of the
    bounds of its members, and its prior is the narrowest of theirs.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> chosen = updyn.cluster(model, chain.measure(), updyn.parameters(model, stiffness="all"))
    >>> len(chosen.parameters)
    4
    """
    return cluster_jointly([Test(model, frf, "", lines, noise)], parameters, threshold)


def cluster_jointly(
    tests: Sequence[Test],
    parameters: ParameterSet | Selection,
    threshold: float = SEPARATION.least_cosine,
) -> Selection:
    """Link unknowns whose effects on the data of several tests are nearly parallel; see `cluster`.

    Parameters
    ----------
    tests : sequence of Test
        At least one; held-out data of the tests are used as data here.
    parameters, threshold
        As for `cluster`.

    Returns
    -------
    Selection

    Raises
    ------
    InputError
        If models, data, unknowns or options are inconsistent.
    SolverError
        If a model cannot be solved at a line.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> halves = [frf.select(references=[r]) for r in frf.references.labels]
    >>> tests = [updyn.Test(model, h, name=n) for h, n in zip(halves, ["a", "b"], strict=True)]
    >>> chosen = updyn.cluster_jointly(tests, updyn.parameters(model, stiffness="all"))
    >>> len(chosen.parameters)
    4
    """
    before = Selection.of(parameters)
    given = before.parameters
    if isinstance(threshold, bool) or not 0.0 < threshold < 1.0:
        raise OptionError(
            f"cluster: threshold = {threshold!r}: expected a cosine between 0 and 1, such as"
            f" {SEPARATION.least_cosine}",
            key=("threshold",),
        )
    R = _whitened_jacobian(tests, before)
    cosine = _cosines(R)
    kinds = list(map(_merge_key, given))
    clusters: list[list[int]] = []
    by_first: dict[int, list[int]] = {}
    members_of_clusters: set[int] = set()
    for members in collinear_clusters(cosine, kinds, threshold):
        if _can_merge(given, members):
            clusters.append(members)
            by_first[members[0]] = members
            members_of_clusters |= set(members)
    items: list[Parameter] = []
    columns: list[RealArray] = []
    merged, least = dict(before.merged), dict(before.cosines)
    for i, p in enumerate(given):
        if i in by_first:
            linked = _merge_unknowns(given, by_first[i])
            merged[linked.name] = tuple(np.array(given.names)[by_first[i]].tolist())
            least[linked.name] = float(cosine[np.ix_(by_first[i], by_first[i])].min())
            columns.append(R[:, by_first[i]].sum(axis=1))
            items.append(linked)
        elif i not in members_of_clusters:
            columns.append(R[:, i])
            items.append(p)
    s = np.linalg.svd(normalise_columns(np.stack(columns, axis=1)), compute_uv=False)
    return replace(
        before,
        parameters=ParameterSet(tuple(items)),
        order=(),
        merged=merged,
        cosines=least,
        remarks=(*before.remarks, *_describe_unmerged(given, cosine, threshold, clusters)),
        singular_values=tuple(s.tolist()),
        collinearity=collinearity_index(s),
    )


# -- clusters --------------------------------------------------------------------------------------
def _common_quantity(p: Parameter) -> str | None:
    """Return the quantity of an unknown; None for sensors and mixed quantities."""
    if p.is_channel:
        return None
    kinds = {(d.quantity, d.power) for d in p.acts_on}
    if len(kinds) > 1:
        return None
    quantity, power = kinds.pop()
    if power != 1.0:
        return None
    return quantity


def _merge_key(p: Parameter) -> str | None:
    """Return quantity and start as a key, equal for unknowns that may be joined, or None."""
    kind = _common_quantity(p)
    if kind is None:
        return None
    return f"{kind} from {p.start!r}"


def _collect_drives(given: ParameterSet, members: list[int]) -> tuple[Drive, ...]:
    drives: list[Drive] = []
    for i in members:
        drives += given[i].acts_on
    return tuple(drives)


def _can_merge(given: ParameterSet, members: list[int]) -> bool:
    """Return whether unknowns can be joined: their bounds overlap, and no group occurs twice."""
    drives = _collect_drives(given, members)
    bounds_overlap = given.lower[members].max() < given.upper[members].min()
    return bool(bounds_overlap) and len(set(drives)) == len(drives)


def _merge_unknowns(given: ParameterSet, members: list[int]) -> Parameter:
    unknowns = [given[i] for i in members]
    first = unknowns[0]
    quantity = first.quantity
    if any(p.quantity != quantity for p in unknowns):
        quantity = first.acts_on[0].quantity
    stem = "+".join(p.group for p in unknowns)
    if len(stem) > _LONG:
        stem = f"{first.group}+{len(unknowns) - 1} more"
    while f"{stem}.{quantity}" in given.names:
        stem += "+"
    priors = [p.prior_std for p in unknowns if p.prior_std is not None]
    nominal, unit = first.nominal, first.unit
    if any((p.nominal, p.unit) != (nominal, unit) for p in unknowns):
        nominal, unit = None, ""
    return Parameter(
        stem,
        quantity,
        first.start,
        given.lower[members].max(),
        given.upper[members].min(),
        min(priors, default=None),
        _collect_drives(given, members),
        nominal,
        unit,
    )


def _describe_unmerged(
    given: ParameterSet, cosine: RealArray, threshold: float, clusters: list[list[int]]
) -> list[str]:
    """Return remarks on unknowns with parallel or opposite effects that were not joined."""
    cluster_of: dict[int, int] = {}
    for number, members in enumerate(clusters):
        cluster_of |= dict.fromkeys(members, number)
    without_effect = np.flatnonzero(~np.isfinite(np.diag(cosine)))
    out = [f"the data do not depend on {given.names[i]}" for i in without_effect]
    reported: set[tuple[int, int]] = set()
    for i, j in combinations(range(len(given)), 2):
        # One remark for each pair of clusters or unknowns is sufficient.
        pair = (cluster_of.get(i, -1 - i), cluster_of.get(j, -1 - j))
        if not abs(cosine[i, j]) >= threshold or pair[0] == pair[1] or pair in reported:
            continue
        reported.add(pair)
        a, b = given[i], given[j]
        if cosine[i, j] < 0:
            why = "their effects are opposite, so that the data determine only their difference"
        elif _common_quantity(a) is None or _common_quantity(a) != _common_quantity(b):
            why = "not of one quantity"
        elif a.start != b.start:
            why = "their starts differ; give them one start to join them"
        else:
            why = "not collinear with all others, or without common bounds"
        out.append(f"{a.name} and {b.name} are not joined (cosine {cosine[i, j]:+.4f}): {why}")
    return out


# -- shared ----------------------------------------------------------------------------------------
def _whitened_jacobian(tests: Sequence[Test], before: Selection) -> RealArray:
    """Return the Jacobian of all data at the start, reduced and whitened by the noise."""
    parameters = before.parameters
    tests = [replace(t, model=before.start_of(t.model)) for t in tests]
    check_tests(tests, parameters)
    return linearise_at_start(*build_start_problem(tests, parameters))[0].R


def _cosines(R: RealArray) -> RealArray:
    columns, size = normalise_columns(R), np.linalg.norm(R, axis=0)
    cosine = np.asarray(columns.T @ columns)
    cosine[size == 0.0, :] = np.nan
    cosine[:, size == 0.0] = np.nan
    return cosine
