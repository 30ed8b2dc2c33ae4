"""Table of the modes of the test, of the start model and of the updated model, paired."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from updyn.arrays import NumberArray
from updyn.correlation import cross_orthogonality
from updyn.correlation.model_modes import ModelModes
from updyn.correlation.modes import BY_FREQUENCY, ModeCorrelation, ModesLike, correlate_modes
from updyn.dynamics.guyan import reduced_mass
from updyn.dynamics.modes import Modes
from updyn.errors import UpdynError, UpdynWarning
from updyn.model import Model
from updyn.text_table import text_table
from updyn.updating.judge.settings import EFFORT

__all__ = ["ModalRow", "ModalTable", "ModeEntry", "compare_modes"]

#: Column headings of the text table.
_COLUMNS = (
    "mode",
    "test (Hz)",
    "start (Hz)",
    "change",
    "MAC",
    "updated (Hz)",
    "change",
    "MAC",
    "loss: test",
    "start",
    "updated",
)


@dataclass(frozen=True, slots=True)
class ModeEntry:
    """A mode in a row of the table; None for values of an unpaired mode.

    `number` is the index in its set; `frequency` is in Hz, `loss_factor` nan if unknown; `change`
    is relative to the frequency of the test, in %; `mac` is that with the test's mode, or with its
    subspace if `in_subspace`.
    """

    number: int
    frequency: float
    loss_factor: float
    change: float | None = None
    mac: float | None = None
    in_subspace: bool = False


@dataclass(frozen=True, slots=True)
class ModalRow:
    """One mode of the structure in the test, at the start and updated; None if not found."""

    test: ModeEntry | None = None
    start: ModeEntry | None = None
    updated: ModeEntry | None = None

    @property
    def frequency(self) -> float:
        """Frequency in Hz by which rows are sorted: of the test, else updated, else start mode."""
        first = self.test or self.updated or self.start
        assert first is not None
        return first.frequency


@dataclass(frozen=True, eq=False)
class ModalTable:
    """Modes of the test, of the start model and of the updated model, at the measured DOFs.

    Sets of the models contain the modes in the band of the test and further paired modes.
    Orthogonalities (n_updated, n_test or n_updated) use the updated mass reduced to the measured
    DOFs; off-diagonal terms of `own_orthogonality` show the error of the reduction. `notes` give
    reasons for unknown values.
    """

    test: Modes | None = None
    start: Modes | None = None
    updated: Modes | None = None
    cross_orthogonality: NumberArray | None = None
    own_orthogonality: NumberArray | None = None
    notes: tuple[str, ...] = ()
    correlations: Mapping[str, ModeCorrelation] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        found = {}
        for name, computed in (("start", self.start), ("updated", self.updated)):
            if computed is not None and self.test is not None:
                found[name] = correlate_modes(computed, self.test)
        object.__setattr__(self, "correlations", found)

    @property
    def known(self) -> bool:
        """Whether the modes of the test and of at least one model are known."""
        return bool(self.correlations)

    @cached_property
    def rows(self) -> tuple[ModalRow, ...]:
        """Rows for all modes of the test, and for modes in its band that only the models have."""
        if self.test is None:
            return ()
        entries: dict[str, dict[int, ModeEntry]] = {"start": {}, "updated": {}}
        for name, found in self.correlations.items():
            change, close = found.frequency_change.tolist(), found.in_subspace.tolist()
            for i, j, mac, by, one in zip(*found.pairs, change, close, strict=True):
                entries[name][int(j)] = _make_entry(
                    found.computed, i, by, float(mac), in_subspace=one
                )
        rows = []
        for j in range(len(self.test)):
            computed = entries["start"].get(j), entries["updated"].get(j)
            rows.append(ModalRow(_make_entry(self.test, j), *computed))
        return tuple(sorted([*rows, *self._unpaired_rows()], key=lambda row: row.frequency))

    def _unpaired_rows(self) -> list[ModalRow]:
        """Return rows for the modes of the models that the test lacks."""
        unpaired: dict[str, list[int]] = {"start": [], "updated": []}
        for name, found in self.correlations.items():
            unpaired[name] = found.unpaired_computed.tolist()
        pairs: list[tuple[int, int]] = []
        if all(unpaired.values()):
            start = self.correlations["start"].computed.select(unpaired["start"])
            updated = self.correlations["updated"].computed.select(unpaired["updated"])
            for i, j in zip(*correlate_modes(start, updated).pairs[:2], strict=True):
                pairs.append((unpaired["start"][i], unpaired["updated"][j]))
        rows = []
        for i, j in pairs:
            rows.append(
                ModalRow(None, self._unpaired_entry("start", i), self._unpaired_entry("updated", j))
            )
        for i in sorted(set(unpaired["start"]) - {i for i, _ in pairs}):
            rows.append(ModalRow(None, self._unpaired_entry("start", i), None))
        for j in sorted(set(unpaired["updated"]) - {j for _, j in pairs}):
            rows.append(ModalRow(None, None, self._unpaired_entry("updated", j)))
        return rows

    def _unpaired_entry(self, name: str, at: int) -> ModeEntry:
        return _make_entry(self.correlations[name].computed, at)

    @property
    def subspace_notes(self) -> tuple[str, ...]:
        """Explanations of the MAC of subspaces, for the last model that has any."""
        notes: list[str] = []
        for one in self.correlations.values():
            notes = one.subspace_notes() or notes
        return tuple(notes)

    def figures(self) -> dict[str, dict[str, float]]:
        """Return the figures of `ModeCorrelation.figures` by ``"start"`` and ``"updated"``."""
        return {name: found.figures() for name, found in self.correlations.items()}

    def text(self) -> str:
        """Return the table as text for the terminal, or the reason why it is unknown."""
        if not self.known:
            return "Modes: not known. " + " ".join(self.notes)
        marks = (" ", "*") if self.subspace_notes else ("", "")
        cells = [[str(i), *_format_row(row, marks)] for i, row in enumerate(self.rows, 1)]
        title = "Modes in the test, at the start and updated (loss: loss factor)"
        columns = [f"MAC{marks[0]}" if name == "MAC" else name for name in _COLUMNS]
        return "\n".join([title, text_table(columns, cells), *self.subspace_notes, *self.notes])


def _make_entry(
    of: Modes,
    at: int,
    change: float | None = None,
    mac: float | None = None,
    *,
    in_subspace: bool = False,
) -> ModeEntry:
    frequency, loss_factor = float(of.frequency[at]), float(of.loss_factor[at])
    return ModeEntry(int(at), frequency, loss_factor, change, mac, in_subspace)


def _format_row(row: ModalRow, marks: tuple[str, str]) -> list[str]:
    start, updated = row.start, row.updated
    cells = [_format_value(row.test, "frequency", "#.5g")]
    for entry in (start, updated):
        cells.append(_format_value(entry, "frequency", "#.5g"))
        cells.append(_format_value(entry, "change", "+.2f", " %").replace("-0.00", "+0.00"))
        mark = marks[entry is not None and entry.in_subspace]
        cells.append(_format_value(entry, "mac", ".3f") + mark)
    for entry in (row.test, start, updated):
        cells.append(_format_value(entry, "loss_factor", "#.3g"))
    return cells


def _format_value(entry: ModeEntry | None, name: str, form: str, unit: str = "") -> str:
    """Return an attribute of an entry as text; ``-`` if missing."""
    value = getattr(entry, name, None)
    if value is None or np.isnan(value):
        return "-"
    return format(value, form).rstrip(".") + unit


def compare_modes(
    start: ModelModes,
    updated: ModelModes | None,
    test: ModesLike,
    band: tuple[float, float] | None = None,
) -> ModalTable:
    """Compare the modes of a test with those of the model before and after an update.

    Values that cannot be computed are None, and a note gives the reason. `band` is in Hz, by
    default from the lowest to the highest measured frequency.
    """
    notes = [] if len(test.dofs) else [BY_FREQUENCY]
    models = {"start": start, "updated": updated}
    found: dict[str, Modes] = {}
    for name, model in models.items():
        if model is None:
            continue
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", UpdynWarning)
                found[name] = correlate_modes(model, test, band=band).computed
        except (UpdynError, np.linalg.LinAlgError) as error:
            notes.append(f"The modes of the {name} model could not be computed: {error}.")
            continue
        notes += [f"The {name} model: {one.message}." for one in caught]
    measured = Modes(test.frequency, test.loss_factor, test.shapes, test.dofs)
    cross_orthogonality, orthogonality = None, None
    is_reducible = 0 < len(test.dofs) <= EFFORT.most_reduced_dofs
    if updated is not None and "updated" in found and is_reducible:
        cross_orthogonality, orthogonality = _compute_orthogonality(
            updated.model, found["updated"], measured, notes
        )
    return ModalTable(
        measured,
        found.get("start"),
        found.get("updated"),
        cross_orthogonality,
        orthogonality,
        tuple(notes),
    )


def _compute_orthogonality(
    model: Model, computed: Modes, measured: Modes, notes: list[str]
) -> tuple[NumberArray | None, NumberArray | None]:
    """Return the cross-orthogonality with the measured modes, and the model's own orthogonality."""
    try:
        mass = reduced_mass(model, measured.dofs)
        shapes = computed.shapes
        return (
            cross_orthogonality(shapes, mass, measured.shapes),
            cross_orthogonality(shapes, mass, shapes),
        )
    except UpdynError as error:
        notes.append(f"Cross-orthogonality is not known: {error}.")
        return None, None
