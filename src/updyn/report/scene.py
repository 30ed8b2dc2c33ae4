"""The structure as a scene of the viewer: modes and operating shapes of updated, start and test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.correlation import ModeCorrelation, Subspace
from updyn.correlation.model_modes import ModelModes
from updyn.dofs import Dof
from updyn.dynamics.excitation import fix_base
from updyn.dynamics.modes import Modes
from updyn.errors import UpdynError
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.geometry import Geometry
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.report.data import ReportData, keep_lines
from updyn.report.formats import unit
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST, REPORT_SIZE
from updyn.style import STATES
from updyn.updating.judge.modal_table import ModalRow, ModalTable, ModeEntry
from updyn.updating.judge.settings import EFFORT
from updyn.updating.result import UpdateResult
from updyn.viewer.bodies import (
    arrows_at,
    connect_nodes,
    entries_of,
    model_body,
    motions,
    sensor_body,
)
from updyn.viewer.colourings import by_size
from updyn.viewer.scene import (
    Body,
    Colouring,
    Layer,
    ModeRow,
    ModeShapes,
    OperatingLayer,
    OperatingShapes,
    Reference,
    Scene,
)

__all__ = ["colour_by_std", "scene_of", "sensors_of"]

#: Colour and style of each layer, after a fit and before any fit. The test has a colour that is in
#: no colour scale of the groups.
_TEST = ("third", "dots")
_GHOST = (STATES["start"], "ghost")
_LOOKS = {"updated": (STATES["updated"], "surface"), "start": _GHOST, "test": _TEST}
_START_LOOKS = {"start": (STATES["start"], "surface"), "test": _TEST}
_OPERATING_LOOKS = {"measured": _TEST, "start": _GHOST, "updated": (STATES["updated"], "wire")}


def scene_of(
    content: PageContent,
    models: Mapping[str, Model],
    data: Sequence[FRF | ModeSet],
    colourings: Sequence[Colouring],
    title: str,
    *,
    moves: bool,
) -> Scene | None:
    """Return the scene of a page; None if the model has no geometry.

    `models` are ``"start"`` and, after a fit, ``"updated"``. `data` of all tests define sensors and
    forces. With `moves`, modes and operating shapes of the content are shown.
    """
    model = models["start"]
    geometry = model.geometry
    if geometry is None or not len(geometry.nodes):
        return None
    responses, references = sensors_of(data)
    body = model_body(model, [*responses, *references])
    arrows, _ = arrows_at(body, geometry, responses, references)
    bodies, notes, colourings = [body], [], list(colourings)
    modes: ModeShapes | None = None
    operating: OperatingShapes | None = None
    has_sensors = np.isin(geometry.nodes, [Dof.parse(label).node for label in responses]).any()
    if moves and has_sensors:
        measured = connect_nodes(sensor_body(_choose_geometry(geometry, data[0]), responses))
        first = data[0]
        computed = {name: content.start_modes.replace_model(one) for name, one in models.items()}
        if isinstance(first, FRF):
            computed = {
                name: one.replace_model(fix_base(one.model, first))
                for name, one in computed.items()
            }
        shapes = _ModalShapes.of(content.modes, computed)
        if shapes is not None:
            modes = shapes.make_layers(body, measured)
            energy = shapes.strain_energy()
            names = list(model.groups)
            mean = energy.mean(axis=0) if len(energy) else np.full(len(names), np.nan)
            colourings.append(
                by_size("Strain energy of the mode", "%", 100 * mean, names, by_row=100 * energy)
            )
            if shapes.left_out:
                notes.append(
                    f"The first {len(modes.rows)} of {len(modes.rows) + shapes.left_out} modes are"
                    " animated."
                )
        if content.has_frfs:
            operating, operating_notes = _make_operating_shapes(content.data, geometry, measured)
            notes += operating_notes
        if modes is not None or operating is not None:
            bodies.append(measured)
    return Scene(bodies, title, colourings, arrows, modes, operating, tuple(notes))


def sensors_of(data: Sequence[FRF | ModeSet]) -> tuple[list[str], list[str]]:
    """Return the DOF labels of sensors and forces of some measurements, without duplicates."""
    # The reference of a transmissibility is a sensor.
    responses: dict[str, None] = {}
    references: dict[str, None] = {}
    for one in data:
        if isinstance(one, ModeSet):
            responses |= dict.fromkeys(one.dofs.labels)
            continue
        responses |= dict.fromkeys(one.responses.labels)
        is_ratio = one.quantity == TRANSMISSIBILITY
        (responses if is_ratio else references).update(dict.fromkeys(one.references.labels))
        if one.force is not None:
            references[str(one.force)] = None
    return list(responses), list(references)


def _choose_geometry(geometry: Geometry, data: FRF | ModeSet) -> Geometry:
    """Return the geometry of the model, with the lines of the test geometry if it has any."""
    test = getattr(data, "geometry", None)
    if test is None or not len(test.lines) or not np.isin(test.lines, geometry.nodes).all():
        return geometry
    return Geometry(geometry.nodes, geometry.xyz, test.lines, geometry.axes)


def colour_by_std(result: UpdateResult) -> Colouring | None:
    """Return a colouring by the largest relative standard deviation in each group."""
    names = list(result.start.groups)
    values = np.full(len(names), np.nan)
    for p in result.parameters:
        for drive in () if p.is_channel else p.acts_on:
            value, std = result.values[p.name], result.std[p.name]
            if drive.group not in names or not value > 0.0 or np.isnan(std):
                continue
            at = names.index(drive.group)
            values[at] = np.fmax(values[at], 100.0 * std / value)
    if np.isnan(values).all():
        return None
    return by_size("Standard deviation", "% of the value", values, names, logarithmic=True)


# -- modes ---------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class _ModalShapes:
    """The modes of a modal table with their shapes at all DOFs of the models."""

    rows: Sequence[ModalRow]
    left_out: int
    models: Mapping[str, Model]
    full: Mapping[str, Modes]
    test: Modes
    correlations: Mapping[str, ModeCorrelation]

    @classmethod
    def of(cls, table: ModalTable, computed: Mapping[str, ModelModes]) -> _ModalShapes | None:
        """Return the shapes; None if no modes are available."""
        models = {name: one.model for name, one in computed.items()}
        n_dofs = models["start"].n_dofs
        if not table.known or table.test is None or n_dofs > EFFORT.most_dofs:
            return None
        full: dict[str, Modes] = {}
        for name, one in computed.items():
            entries = [getattr(row, name) for row in table.rows]
            highest = max((e.frequency for e in entries if e is not None), default=0.0)
            if highest > 0.0:
                try:
                    full[name] = one.damped(highest * (1.0 + REPORT_LIST.same_frequency))
                except (UpdynError, np.linalg.LinAlgError):  # the section on modes says why
                    continue
        if not full:
            return None
        most = max(REPORT_SIZE.mode_displacements // (6 * n_dofs), REPORT_SIZE.least_modes)
        kept = table.rows[:most]
        return cls(kept, len(table.rows) - len(kept), models, full, table.test, table.correlations)

    @property
    def looks(self) -> Mapping[str, tuple[str, str]]:
        """Colour and style of each layer, by name."""
        return _LOOKS if "updated" in self.models else _START_LOOKS

    def subspace(self, name: str, row: ModalRow) -> Subspace | None:
        """Return the subspace that contains a model's mode; None for a single mode."""
        entry: ModeEntry | None = getattr(row, name)
        if entry is None or not entry.in_subspace:
            return None
        found = self.correlations[name].subspaces
        return next(one for one in found if entry.number in one.computed)

    def model_shape(self, name: str, row: ModalRow) -> NumberArray | None:
        """Return the shape of a model's mode; None without one."""
        # Close modes of a model are combined to the shape nearest to the test mode (least
        # squares).
        entry: ModeEntry | None = getattr(row, name)
        if entry is None or name not in self.full:
            return None
        full, close = self.full[name], self.subspace(name, row)
        same = REPORT_LIST.same_frequency
        if close is not None and close.close != "measured" and row.test is not None:
            low, high = close.frequency_computed.min(), close.frequency_computed.max()
            inside = (full.frequency >= low * (1 - same)) & (full.frequency <= high * (1 + same))
            near = full.select(inside)
            target = self.test.shapes[:, row.test.number]
            return np.asarray(near.shapes @ np.linalg.lstsq(near.at(self.test.dofs), target)[0])
        away = np.abs(full.frequency - entry.frequency)
        at = int(np.argmin(away))
        return full.shapes[:, at] if away[at] <= same * entry.frequency else None

    def test_shape(
        self, row: ModalRow, close: Subspace | None, at_sensors: NumberArray | None
    ) -> Any:
        """Return the shape of a test mode, scaled to the model's; None without a test mode."""
        # Close modes of the test paired with separate model modes are combined to the shape
        # nearest to the model's.
        if row.test is None:
            return None
        shape = self.test.shapes[:, row.test.number]
        if at_sensors is None:
            return shape
        if close is not None and close.close == "measured":
            near = self.test.shapes[:, close.measured]
            return near @ np.linalg.lstsq(near, at_sensors)[0]
        return _scale_to(shape, at_sensors)

    def make_layers(self, body: Body, measured: Body) -> ModeShapes:
        """Return the layers; shapes of a row are scaled in size and phase to the first of them."""
        geometry = self.models["start"].geometry
        assert geometry is not None
        found: dict[str, list[NumberArray]] = {name: [] for name in self.looks}
        rows = []
        for number, row in enumerate(self.rows, 1):
            members = []
            for name, shape in self._align_row(row).items():
                if shape is None:
                    members.append(-1)
                    continue
                found[name].append(shape)
                members.append(len(found[name]) - 1)
            rows.append(ModeRow(f"{number}: {_row_text(row)}", tuple(members)))
        layers = []
        for name, (role, style) in self.looks.items():
            layer_body, at = (measured, 1) if name == "test" else (body, 0)
            dofs = self.test.dofs if name == "test" else self.models[name].dofs
            shapes = np.array(found[name]).reshape(-1, len(dofs)).T
            entries = entries_of(layer_body, geometry, dofs)
            layers.append(Layer(name, role, style, at, motions(layer_body, entries, shapes)))
        return ModeShapes(layers, rows)

    def _align_row(self, row: ModalRow) -> dict[str, NumberArray | None]:
        """Return the shapes of a row, those of the test scaled in size and phase to a model's."""
        out: dict[str, NumberArray | None] = dict.fromkeys(self.looks)
        first: NumberArray | None = None
        at_sensors: NumberArray | None = None
        close: Subspace | None = None
        for name in self.models:
            shape = self.model_shape(name, row)
            if shape is None:
                continue
            out[name] = shape if first is None else _scale_to(shape, first)
            if first is None:
                match = self.full[name].dofs.match(self.test.dofs)
                first, at_sensors = shape, shape[match.index] * match.sign
                close = self.subspace(name, row)
        out["test"] = self.test_shape(row, close, at_sensors)
        return out

    def strain_energy(self) -> RealArray:
        """Return the strain energy fraction of each group by row, shape (n_rows, n_groups)."""
        groups = self.models["start"].groups
        out = np.full((len(self.rows), len(groups)), np.nan)
        for number, row in enumerate(self.rows):
            shapes = {name: self.model_shape(name, row) for name in ("start", "updated")}
            name = "start" if shapes["updated"] is None else "updated"
            shape = shapes[name]
            if shape is None:
                continue
            stiffness = [group.stiffness for group in self.models[name].groups.values()]
            energy = [0.0 if K is None else np.vdot(shape, K @ shape).real for K in stiffness]
            total = float(np.sum(energy))
            if total > 0.0:
                out[number] = np.maximum(np.array(energy) / total, 0.0)
        return out


def _scale_to(shape: NumberArray, target: NumberArray) -> NumberArray:
    """Return a shape times its modal scale factor to the target."""
    size = np.vdot(shape, shape).real
    factor = np.vdot(shape, target) / size if size > 0.0 else 0.0
    return np.asarray(shape * (factor if factor != 0.0 else 1.0))


def _row_text(row: ModalRow) -> str:
    parts = []
    for name in ("test", "start", "updated"):
        entry = getattr(row, name)
        if entry is not None:
            parts.append(f"{name} {entry.frequency:.5g} Hz")
    entry = row.updated or row.start
    if entry is not None and entry.mac is not None and np.isfinite(entry.mac):
        single = f"MAC {entry.mac:.3f}"
        close = f"subspace MAC {entry.mac:.3f}, close modes combined"
        parts.append(close if entry.in_subspace else single)
    return ", ".join(parts)


# -- operating shapes ----------------------------------------------------------------------------
def _make_operating_shapes(
    data: ReportData, geometry: Geometry, measured: Body
) -> tuple[OperatingShapes | None, list[str]]:
    """Return the operating shapes, and notes on omitted lines and references."""
    if not len(data.freq):
        return None, []
    states = {"measured": data.measured, "start": data.before, "updated": data.after}
    looks = dict(_OPERATING_LOOKS)
    if data.after is None:
        looks["start"] = (STATES["start"], "wire")
    present = {name: values for name, values in states.items() if values is not None}
    notes = []
    shown = min(len(data.references), REPORT_SIZE.operating_references)
    if shown < len(data.references):
        notes.append(
            f"Operating shapes are shown for the first {shown} of {len(data.references)} forces."
        )
    per_line = shown * len(data.responses) * len(present)
    limit = max(REPORT_SIZE.operating_values // per_line, REPORT_SIZE.least_operating_lines)
    at = keep_lines(data.measured, data.used, limit)
    if len(at) < len(data.freq):
        notes.append(f"Operating shapes are shown at {len(at)} of {len(data.freq)} lines.")
    references = []
    for number, name in enumerate(data.references[:shown]):
        layers = [
            OperatingLayer(state, *looks[state], values[at, :, number])
            for state, values in present.items()
        ]
        references.append(Reference(name, layers))
    entries = entries_of(measured, geometry, data.responses)
    of = unit(data.quantity, data.responses[0], data.references[0])
    freq = data.freq[at]
    return OperatingShapes(freq, data.quantity, of, 1, entries, references), notes
