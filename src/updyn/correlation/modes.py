"""Correlation of modes: pairing, MAC, changes of frequency and damping; `correlate_modes`."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from updyn.arrays import BoolArray, IndexArray, NumberArray, RealArray
from updyn.correlation.clusters import (
    PairedModes,
    PairingRule,
    Subspace,
    pair_clusters,
    pair_frequencies,
    principal_vectors,
)
from updyn.correlation.model_modes import ModelModes
from updyn.correlation.settings import MODE_PAIRING
from updyn.correlation.shapes import (
    ModePairs,
    auto_mac,
    comac,
    cross_orthogonality,
    ecomac,
    find_moving,
    mac,
)
from updyn.dofs import Dof, DofSet
from updyn.dynamics.modes import Modes
from updyn.errors import DataError, DofError
from updyn.frf import check_band
from updyn.group import is_number
from updyn.model import Model
from updyn.notebook import card, table
from updyn.text_table import text_table

__all__ = [
    "BY_FREQUENCY",
    "ModeCorrelation",
    "ModesLike",
    "correlate_modes",
    "weigh_sensors",
]

Array = RealArray

#: Note on the pairing of modes without shapes.
BY_FREQUENCY = (
    "The measured modes have no shapes: they are paired in the order of their frequencies. Shapes"
    " would show whether the pairs are right."
)


@runtime_checkable
class ModesLike(Protocol):
    """Modes at signed DOFs, computed (`updyn.dynamics.modes.Modes`) or measured (`ModeSet`)."""

    @property
    def frequency(self) -> Array:
        """Natural frequencies in Hz, shape (n,), ascending."""

    @property
    def loss_factor(self) -> Array:
        """Modal loss factors, shape (n,); nan if unknown."""

    @property
    def shapes(self) -> NumberArray:
        """Shapes as columns, (N, n)."""

    @property
    def dofs(self) -> DofSet:
        """DOFs of the rows."""


@dataclass(frozen=True, slots=True, eq=False)
class ModeCorrelation:
    """The correlation of computed and measured modes.

    Attributes
    ----------
    computed, measured : Modes
        Both at the compared DOFs, with the labels and signs of the measured modes; shapes of any
        scale.
    mac : ndarray of float, shape (n_computed, n_measured)
        Modal assurance criterion, see `updyn.correlation.mac`. If both translations and rotations
        are compared, rotations are multiplied by a length that makes them as large as the
        translations over the measured modes; otherwise MAC would depend on the unit of length.
    pairs : ModePairs
        Columns of paired computed (``first``) and measured modes (``second``), and their MAC, by
        ascending measured frequency. The MAC of a pair in a subspace is that of the subspace, and
        the pairing within it is arbitrary.
    subspaces : tuple of Subspace
        Close modes. Their shapes are an arbitrary basis and are compared by their spans.
    close : float
        Largest relative difference of frequency of close modes.
    """

    computed: Modes
    measured: Modes
    mac: Array
    pairs: ModePairs
    subspaces: tuple[Subspace, ...] = ()
    close: float = MODE_PAIRING.close_frequencies

    def __repr__(self) -> str:
        return (
            f"ModeCorrelation({len(self.pairs.mac)} pairs of {len(self.computed)} computed and"
            f" {len(self.measured)} measured modes at {len(self.dofs)} DOFs)"
        )

    @property
    def dofs(self) -> DofSet:
        """DOFs at which shapes are compared, in the order of their rows."""
        return self.measured.dofs

    @property
    def frequency_change(self) -> Array:
        """Computed over measured frequency minus 1, in %, by pair; nan if both are 0."""
        first = self.computed.frequency[self.pairs.first]
        second = self.measured.frequency[self.pairs.second]
        change = np.full(len(first), np.nan)
        np.divide(first - second, second, out=change, where=second > 0)
        return 100.0 * change

    @property
    def unpaired_computed(self) -> IndexArray:
        """Computed modes without a pair."""
        return np.setdiff1d(np.arange(len(self.computed)), self.pairs.first)

    @property
    def unpaired_measured(self) -> IndexArray:
        """Measured modes without a pair."""
        return np.setdiff1d(np.arange(len(self.measured)), self.pairs.second)

    @property
    def in_subspace(self) -> BoolArray:
        """Whether the MAC of a pair is that of a subspace, by pair."""
        close = [one.measured for one in self.subspaces]
        return np.isin(self.pairs.second, np.concatenate([np.zeros(0, np.intp), *close]))

    @property
    def auto_mac(self) -> Array:
        """MAC of the measured modes with each other, shape (n_measured, n_measured).

        Large off-diagonal values mean that the sensors cannot distinguish these shapes.
        """
        if not len(self.dofs):
            return np.full((len(self.measured), len(self.measured)), np.nan)
        return auto_mac(_scale_rotations(self.measured, self.measured))

    def comac(self) -> Array:
        """Return the co-ordinate MAC over the pairs, shape (n_dofs,); nan without a pair.

        See `updyn.correlation.comac`. A low value indicates a faulty sensor, or a place with a
        different motion of the model. For a subspace, the principal vectors are compared.
        """
        return self._by_dof(comac)

    def ecomac(self) -> Array:
        """Return the enhanced co-ordinate MAC over the pairs, shape (n_dofs,); nan without a pair.

        See `updyn.correlation.ecomac`: 0 without difference; sensitive to signs and gains of
        sensors.
        """
        return self._by_dof(ecomac)

    def _by_dof(self, criterion: Any) -> Array:
        if not len(self.pairs.mac) or not len(self.dofs):
            return np.full(len(self.dofs), np.nan)
        a = _scale_rotations(self.computed, self.measured)
        b = _scale_rotations(self.measured, self.measured)
        single = ~self.in_subspace
        columns = [(a[:, self.pairs.first[single]], b[:, self.pairs.second[single]])]
        for one in self.subspaces:
            n_pairs = int(np.isin(self.pairs.second, one.measured).sum())
            columns.append(principal_vectors(a[:, one.computed], b[:, one.measured], n_pairs))
        computed, measured = (np.hstack(part) for part in zip(*columns, strict=True))
        return np.asarray(criterion(computed, measured))

    def cross_orthogonality(self, mass: object) -> NumberArray:
        """Return the cross-orthogonality of computed and measured modes.

        Parameters
        ----------
        mass : array_like or sparse, shape (n_dofs, n_dofs)
            Mass at `dofs`, in kg (kg m2), as `updyn.dynamics.guyan.reduced_mass` returns it.

        Returns
        -------
        ndarray, shape (n_computed, n_measured)
            See `updyn.correlation.cross_orthogonality`.

        Raises
        ------
        DataError
            If the size differs, or a shape has no mass.
        """
        return cross_orthogonality(self.computed.shapes, mass, self.measured.shapes)

    def figures(self) -> dict[str, float]:
        """Return counts of modes, MAC (median, min) and change of frequency (median, max, in %).

        Without a pair, MAC and change are nan. The MAC of pairs in a subspace is that of the
        subspace.
        """
        change = np.abs(self.frequency_change)
        found = {
            "pairs": float(len(change)),
            "unpaired_computed": float(len(self.unpaired_computed)),
            "unpaired_measured": float(len(self.unpaired_measured)),
        }
        values = {"mac_median": np.nan, "mac_min": np.nan}
        values |= {"frequency_change_median": np.nan, "frequency_change_max": np.nan}
        if len(change):
            values["mac_median"] = np.median(self.pairs.mac)
            values["mac_min"] = self.pairs.mac.min()
            values["frequency_change_median"] = np.median(change)
            values["frequency_change_max"] = change.max()
        return found | {name: float(value) for name, value in values.items()}

    def table(self) -> str:
        """Return paired and unpaired modes as a text table by ascending frequency.

        The MAC of subspaces is marked by an asterisk, and explained below the table.
        """
        return "\n".join([text_table(*self.rows()), *self.notes()])

    def _repr_html_(self) -> str:
        facts = {
            "pairs": len(self.pairs.mac),
            "computed": len(self.computed),
            "measured": len(self.measured),
            "DOFs": len(self.dofs),
        }
        notes = "<br>".join(map(html.escape, self.notes()))
        return card("Correlation of modes", facts, table(*self.rows()), notes)

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """Return header and rows of `table`.

        Returns
        -------
        header : list of str
        rows : list of list of str
            A cell for each heading, by ascending frequency.
        """
        rows = []
        marks = [self._mark(close) for close in self.in_subspace.tolist()]
        pairs = zip(*self.pairs, self.frequency_change, marks, strict=True)
        for i, j, value, change, mark in pairs:
            cells = [*_format_mode(self.measured, j), *_format_mode(self.computed, i)]
            frequency = float(self.measured.frequency[j])
            shown = "-" if np.isnan(value) else f"{value:.3f}"
            rows.append((frequency, [*cells, f"{change:+.2f}", f"{shown}{mark}"]))
        for j in self.unpaired_measured:
            cells = [*_format_mode(self.measured, j), "-", "-", "-", f"-{self._mark(False)}"]
            rows.append((float(self.measured.frequency[j]), cells))
        for i in self.unpaired_computed:
            cells = ["-", "-", *_format_mode(self.computed, i), "-", f"-{self._mark(False)}"]
            rows.append((float(self.computed.frequency[i]), cells))
        rows.sort(key=lambda row: row[0])
        header = ["mode", "measured (Hz)", "loss factor", "computed (Hz)", "loss factor"]
        header += ["change (%)", f"MAC{self._mark(False)}"]
        return header, [[str(i), *cells] for i, (_, cells) in enumerate(rows, 1)]

    def notes(self) -> list[str]:
        """Return notes on modes without shapes, and the explanations of `subspace_notes`.

        Returns
        -------
        list of str
            Lines of text; may be empty.
        """
        return ([] if len(self.dofs) else [BY_FREQUENCY]) + self.subspace_notes()

    def _mark(self, subspace: bool) -> str:
        """Return the mark of a MAC in tables: an asterisk for subspaces, else a blank."""
        if not self.subspaces:
            return ""
        return "*" if subspace else " "

    def subspace_notes(self) -> list[str]:
        """Return explanations of the MAC of each subspace; empty without subspaces.

        Returns
        -------
        list of str
            The meaning of the value, then the modes of each subspace, one line of text each.
        """
        if not self.subspaces:
            return []
        return [
            f"* Subspace MAC of modes within {100.0 * self.close:.2g} % of frequency, whose single"
            " shapes are arbitrary: the lowest MAC that a shape of one span has with the other.",
            *(f"* {one.text()[0].upper()}{one.text()[1:]}." for one in self.subspaces),
        ]


def _format_mode(of: Modes, at: int) -> list[str]:
    """Return frequency and loss factor of a mode as text."""
    loss = float(of.loss_factor[at])
    frequency = f"{of.frequency[at]:#.5g}".rstrip(".")
    return [frequency, "-" if np.isnan(loss) else f"{loss:#.3g}"]


def correlate_modes(
    computed: Model | ModelModes | ModesLike,
    measured: ModesLike,
    *,
    band: tuple[float, float] | None = None,
    gate: float = MODE_PAIRING.frequency_gate,
    least_mac: float = MODE_PAIRING.least_mac,
    close: float = MODE_PAIRING.close_frequencies,
    dofs: Iterable[str | Dof] | None = None,
) -> ModeCorrelation:
    """Pair computed and measured modes one to one and compare them.

    Parameters
    ----------
    computed : Model, ModelModes, Modes or ModeSet
        The modes of a model are computed (`ModelModes.damped`); those within `band` and paired
        ones are kept. Given modes are all kept.
    measured : ModeSet or Modes
        The measured modes.
    band : (float, float), optional
        For a model, the band in Hz in which modes could be measured; by default from the lowest to
        the highest measured frequency.
    gate : float
        Largest difference of frequency of a pair, as a share of the lower frequency.
    least_mac : float
        Least MAC of a pair, after subtraction of the term for the difference of frequency (see
        Notes).
    close : float
        Modes of one set whose frequencies differ by at most this share are compared by the span of
        their shapes; 0 for equal frequencies only.
    dofs : iterable of str or Dof, optional
        DOFs at which shapes are compared; by default all DOFs of the measured modes, which the
        computed modes must have. Labels may differ in sign and order.

    Returns
    -------
    ModeCorrelation

    Raises
    ------
    DataError
        If an argument has a wrong type or value, the model has no mode in the range, or a shape is
        zero at these DOFs.
    DofError
        If a DOF is not in one of the two.
    ModelError, SolverError
        If the modes of the model cannot be computed.

    Notes
    -----
    The pairs maximise the sum of MAC - 0.4 (|f_c - f_m| / (gate min(f_c, f_m)))^2 over all
    one-to-one assignments (Kuhn, Naval Res. Logist. Q. 2 (1955) 83-97), each of at least
    `least_mac`. The second term decides if the sensors cannot distinguish shapes.

    Measured modes without shapes are paired within the gate with the least sum of the squared
    logarithms of the ratios of their frequencies, which keeps their order; MAC is nan.

    The shapes of close modes are an arbitrary basis of their span. Between clusters of them, MAC is
    replaced by the mean of the squared cosines of the principal angles between the spans (Bjorck &
    Golub, Math. Comp. 27 (1973) 579-594) that are at least `least_mac`; clusters have no more pairs
    than such angles. Clusters that are joined by pairs are one `Subspace`, and each of their pairs
    has its subspace MAC: the squared cosine of the largest of these angles. Modes that are close in
    one of the two sets only are compared in the same way, and `Subspace.close` states the set.
    """
    if not isinstance(measured, ModesLike):
        raise DataError(f"correlate: expected measured modes, found {type(measured).__name__}")
    numbers = is_number(gate) and is_number(least_mac)
    if not numbers or not gate > 0 or not 0 <= least_mac <= 1:
        raise DataError(
            f"correlate: gate = {gate!r}, least_mac = {least_mac!r}; expected a gate above 0 and a"
            " MAC from 0 to 1"
        )
    if not is_number(close) or not 0 <= close < 1:
        raise DataError(
            f"correlate: close = {close!r}; expected a share of the frequency from 0 to below 1,"
            f" such as {MODE_PAIRING.close_frequencies:g}"
        )
    rule = PairingRule(gate, least_mac, close)
    at = measured.dofs
    if dofs is not None:
        at = DofSet(dofs)
    alone = dofs is None and len(at) == 0
    if len(at) == 0 and not alone:
        raise DofError("correlate: no DOF to compare the shapes at")
    b = _reduce_to_dofs(measured, at)
    if isinstance(computed, Model):
        computed = ModelModes(computed)
    if isinstance(computed, ModelModes):
        low, high = float(b.frequency[0]), float(b.frequency[-1])
        if band is not None:
            low, high = check_band(band)
        found = computed.damped(max(high, float(b.frequency[-1])) * (1.0 + gate))
        at_sensors = _reduce_to_dofs(found, at)
        move = np.ones(len(found), bool) if alone else find_moving(at_sensors.shapes, found.shapes)
        if not move.any():
            raise DataError(
                f"correlate: none of the {len(found)} modes of the model up to"
                f" {found.frequency[-1]:g} Hz moves at the DOFs of the measured modes"
            )
        a = at_sensors.select(move)
        matched = _pair_modes(a, b, rule)
        listed = (a.frequency >= low) & (a.frequency <= high)
        listed[matched.computed_modes] = True
        if not listed.any():
            raise DataError(
                f"correlate: the model has no mode from {low:g} to {high:g} Hz that moves at the"
                " DOFs of the measured modes, and none that is paired with one of them"
            )
        a, matched = a.select(listed), matched.renumber(listed)
    elif isinstance(computed, ModesLike):
        a = _reduce_to_dofs(computed, at)
        matched = _pair_modes(a, b, rule)
    else:
        raise DataError(
            f"correlate: expected a Model or modes, found {type(computed).__name__}; measured FRFs"
            " are turned into modes by updyn.identify_modes"
        )
    values = _compute_mac(a, b)
    values.flags.writeable = False
    return ModeCorrelation(a, b, values, matched.pairs, matched.subspaces, close)


def _reduce_to_dofs(of: ModesLike, dofs: DofSet) -> Modes:
    """Return modes at a subset of their DOFs, with the signs of these labels."""
    match = of.dofs.match(dofs, "DOF of the measured modes")
    shapes = np.asarray(of.shapes[match.index] * match.sign[:, None])
    return Modes(of.frequency, of.loss_factor, shapes, dofs)


def _compute_mac(a: Modes, b: Modes) -> Array:
    if not len(b.dofs):
        return np.full((len(a), len(b)), np.nan)
    return mac(_scale_rotations(a, b), _scale_rotations(b, b))


def _scale_rotations(of: Modes, measured: ModesLike) -> NumberArray:
    """Return shapes with rotations scaled to the average size of translations in measured modes."""
    return np.asarray(of.shapes * weigh_sensors(measured)[:, None])


def weigh_sensors(measured: ModesLike) -> Array:
    """Return the weight of each sensor in MAC: 1 for translations, a length in m for rotations."""
    rotates = measured.dofs.axes >= 3
    weights, size = np.ones(len(rotates)), np.abs(measured.shapes) ** 2
    if rotates.all() or not rotates.any():
        return weights
    ratio = np.sqrt(size[~rotates].mean(axis=0)), np.sqrt(size[rotates].mean(axis=0))
    both = (ratio[0] > 0) & (ratio[1] > 0)
    if both.any():
        weights[rotates] = np.exp(np.mean(np.log(ratio[0][both] / ratio[1][both])))
    return weights


def _pair_modes(a: Modes, b: Modes, rule: PairingRule) -> PairedModes:
    if not len(b.dofs):
        return PairedModes(pair_frequencies((a.frequency, b.frequency), rule.gate), ())
    at_sensors = _scale_rotations(a, b), _scale_rotations(b, b)
    return pair_clusters(*at_sensors, (a.frequency, b.frequency), rule)
