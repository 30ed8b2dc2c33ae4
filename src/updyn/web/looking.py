"""Content of the pages about a job, as plain data: read, matched and solved in a `Desk`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.correlation import correlate, relative_residual
from updyn.dofs import Dof
from updyn.dynamics.excitation import fix_base
from updyn.dynamics.modes import modes
from updyn.errors import InputError, UpdynError
from updyn.frf import FRF, unit
from updyn.io import read_model
from updyn.job import Job, Prepared, job_findings, job_identifiability, load_job, prepare
from updyn.job.prepare import prepare_model, read_measurement
from updyn.job.prepared import PreparedTest
from updyn.job.proposal import job_text, propose_unknown, read_inputs
from updyn.job.start import choose_tier, counterparts_at_start, start_models
from updyn.matching.result import MatchError
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.report.data import fine_grid, keep_lines
from updyn.updating.before_search import REMEDY
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.fault import FORCE
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.level_model import respond_as_measured
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.viewer import model_scene, page
from updyn.web.settings import WEB_PAGE

__all__ = [
    "CHOICES",
    "FORWARD",
    "CheckRow",
    "FindingRow",
    "IdentifiabilityView",
    "JobView",
    "ModalView",
    "ModelView",
    "RepairView",
    "TestView",
    "assess_identifiability",
    "check_job",
    "compute_model",
    "compute_run_model",
    "count_counterparts",
    "find_faults",
    "propose_job",
    "read_run",
    "read_view",
    "render_structure",
]

T = TypeVar("T")

#: Quantities of a group that are chosen by a click.
CHOICES = ("stiffness", "mass", "loss_factor")


@dataclass(frozen=True, slots=True, eq=False)
class TestView:
    """One test as measured, before its band.

    `freq`, shape (n_lines,), `band` and `held_band` are in Hz; `values`, shape (n_lines,
    n_responses, n_references), in SI. `used` marks the lines that band and exclusions leave. `held`
    and the keys of `holdable` are labels in the job, `responses` and the values of `holdable`
    labels in the file. `matches` is empty if the sensors could not be matched.
    """

    number: int
    name: str
    quantity: str
    freq: RealArray
    values: NDArray[np.complex64]
    responses: list[str]
    references: list[str]
    used: BoolArray
    band: tuple[float, float] | None
    matches: list[dict[str, str]]
    held: list[str]
    held_band: tuple[float, float] | None
    holdable: Mapping[str, str]
    coherence: NDArray[np.float32] | None

    def find_unit(self, row: int, column: int) -> str:
        """Return the unit of a channel."""
        return unit(self.quantity, self.responses[row], self.references[column])


@dataclass(frozen=True, slots=True)
class ModalView:
    """One test whose data are modes in the band; frequencies as text in Hz."""

    number: int
    name: str
    modes: list[dict[str, str]]
    matches: list[dict[str, str]]


@dataclass(frozen=True, slots=True, eq=False)
class JobView:
    """A job as far as it can be read.

    `groups_by_quantity` has the quantities of `CHOICES` as keys. `errors` has the errors by the
    table of the job that they are about, such as ``"test"``; ``"job"`` if it cannot be read.
    `has_picture` states whether the model has a geometry, `is_large` whether a response of the
    model takes long. `proposals` has the proposed keys of a new unknown by quantity.
    """

    title: str
    model: str
    groups: list[str]
    groups_by_quantity: Mapping[str, list[str]]
    tests: list[TestView]
    modal: list[ModalView]
    unknowns: list[Parameter]
    errors: Mapping[str, str]
    has_picture: bool = False
    is_large: bool = False
    proposals: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class IdentifiabilityView:
    """Identifiability: `rank` of `n` unknowns, Brun's collinearity index, and advice.

    `undetermined` names the unknowns that each undetermined unknown is confused with.
    """

    rank: int
    n: int
    collinearity: float
    undetermined: Mapping[str, str]
    advice: str


@dataclass(frozen=True, slots=True, eq=False)
class ModelView:
    """The model of a test at values of the unknowns, and the data that the fit uses.

    Both have the channels of `TestView`, nan where the fit has none: `values` on the lines `freq`
    in Hz, which resolve the resonances, and `repaired` on `repaired_freq` if the job repairs the
    data, else None. `level_error` is the median level difference from the fitted data, in dB.
    """

    freq: RealArray
    values: NDArray[np.complex64]
    level_error: float
    repaired_freq: RealArray
    repaired: NDArray[np.complex64] | None


@dataclass(frozen=True, slots=True, eq=False)
class RepairView:
    """The channel that a repair changes most: data before and after, and the model at the start.

    `freq` is in Hz; values are in the quantity of the test, in SI. `residual_before` and
    `residual_after` are the relative residuals of the channel, `unit` is that of its values.
    """

    channel: str
    freq: RealArray
    before: NDArray[np.complex64]
    after: NDArray[np.complex64]
    model: NDArray[np.complex64]
    residual_before: float
    residual_after: float
    unit: str


@dataclass(frozen=True, slots=True)
class FindingRow:
    """A suspected fault of the data or the model of a test.

    `repair` is the entry of ``repair`` in the job that corrects it; empty if none can. `omissible`
    has the faulty sensors without sign, as the file labels them, by the key of ``[test]`` that can
    leave them out. `view` is None if no model can be compared.
    """

    statement: str
    remedy: str
    repair: str
    odds: float
    test: int
    omissible: Mapping[str, list[str]]
    view: RepairView | None = None


@dataclass(frozen=True, slots=True)
class CheckRow:
    """A statement of a check before a run, with a remedy if it `is_problem`.

    `repair` is the entry of ``repair`` of `test` that corrects it; empty if none can.
    """

    statement: str
    is_problem: bool = False
    remedy: str = ""
    repair: str = ""
    test: int = 0


@lru_cache(maxsize=4)
def _load_and_prepare(path: Path, text: str) -> Prepared:
    return prepare(load_job(path, text=text))


def read_view(path: Path, text: str) -> JobView:
    """Read a job and all its files; errors replace parts that cannot be read."""
    errors: dict[str, str] = {}
    job = _try_part(lambda: load_job(path, text=text), errors)
    if job is None:
        return JobView("", "", [], {}, [], [], [], errors)
    ready = _try_part(lambda: _load_and_prepare(path, text), errors)
    tests = []
    for number, part in enumerate(job.parts):
        if not part.has_modes:
            view = _try_part(
                lambda part=part, at=number: _view_test(part, at, ready),  # type: ignore[misc]
                errors,
            )
            tests += [] if view is None else [view]
    prepared: Sequence[PreparedTest] = ()
    if ready is not None:
        model, parameters, prepared = ready.model, ready.parameters, ready.tests
    else:
        built = _try_part(lambda: prepare_model(job), errors)
        if built is None:
            return JobView(job.find_title(), "", [], {}, tests, [], [], errors)
        model, parameters = built
    modal = [
        _view_modes(test, number)
        for number, test in enumerate(prepared)
        if isinstance(test.data, ModeSet)
    ]
    return JobView(
        job.find_title(model.title),
        f"{model.n_dofs:,} DOFs in {len(model.groups)} groups",
        list(model.groups),
        _find_groups_by_quantity(model),
        tests,
        modal,
        list(parameters),
        errors,
        has_picture=model.geometry is not None,
        is_large=model.n_dofs > WEB_PAGE.quick_dofs,
        proposals={quantity: propose_unknown(model, quantity) for quantity in CHOICES},
    )


def _find_groups_by_quantity(model: Model) -> dict[str, list[str]]:
    stiff = [name for name, group in model.groups.items() if group.stiffness is not None]
    heavy = [name for name, group in model.groups.items() if group.mass is not None]
    return {"stiffness": stiff, "mass": heavy, "loss_factor": stiff}


def _try_part(make: Callable[[], T], errors: dict[str, str]) -> T | None:
    """Return the result of a function, or None after storing its error in `errors`."""
    try:
        return make()
    except UpdynError as error:
        errors.setdefault(_find_table(error), str(error))
        return None


def _find_table(error: UpdynError) -> str:
    """Return the table that an error is about; "job" if it does not tell."""
    key: tuple[str | int, ...] = ()
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MatchError):
            return "match"
        key = key or (cause.key if isinstance(cause, InputError) else ())
        cause = cause.__cause__
    return str(key[0]) if key else "job"


def _view_test(part: Job, number: int, ready: Prepared | None) -> TestView:
    table = part.test
    free = table.model_copy(update={"band": None, "exclude": None})
    with part.located():
        whole = read_measurement(part.model_copy(update={"test": free}))
    try:
        used = np.isin(whole.freq, whole.select(band=table.band, exclude=table.exclude or ()).freq)
    except InputError:  # no line remains; the error is reported for the whole job
        used = np.zeros(len(whole.freq), dtype=bool)
    held, held_band = _find_validation_set(part)
    return TestView(
        number,
        table.name,
        whole.quantity,
        whole.freq,
        whole.values.astype(np.complex64),
        whole.responses.labels,
        whole.references.labels,
        used,
        table.band,
        [] if ready is None else _list_matches(ready.tests[number]),
        held,
        held_band,
        _list_holdable(held, None if ready is None else ready.tests[number]),
        None if whole.coherence is None else whole.coherence.astype(np.float32),
    )


def _list_matches(test: PreparedTest) -> list[dict[str, str]]:
    return [
        {
            "sensor": row.sensor,
            "is": row.role,
            "dof": row.dof,
            "distance": f"{row.distance:.3g}" if np.isfinite(row.distance) else "",
        }
        for row in test.matching.table
    ]


def _find_validation_set(part: Job) -> tuple[list[str], tuple[float, float] | None]:
    """Return the responses and the band that a test holds out; one of them, or none."""
    labels: list[str] = []
    numbers: list[float] = []
    for one in part.validation or ():
        if isinstance(one, str):
            labels.append(one)
        else:
            numbers.append(one)
    return labels, (numbers[0], numbers[1]) if numbers else None


def _list_holdable(held: Sequence[str], test: PreparedTest | None) -> dict[str, str]:
    """Return what may be held out, by the label for the job; one that is held keeps its writing."""
    if test is None:
        return {label: label for label in held}
    written = {abs(Dof.parse(label)): label for label in held}
    sensors = {abs(Dof.parse(row.dof)): row.sensor for row in test.matching.table}
    found: dict[str, str] = {}
    for dof in test.frf.responses:
        label = written.get(abs(dof), str(dof))
        sensor = sensors.get(abs(dof), label)
        same = abs(Dof.parse(sensor)) == abs(dof)
        found[label] = label if same else f"{label} (sensor {sensor})"
    return found


def _view_modes(test: PreparedTest, number: int) -> ModalView:
    found = test.data
    assert isinstance(found, ModeSet)
    rows = zip(
        _format_values(found.frequency, found.std_frequency, ".6g"),
        _format_values(found.loss_factor, found.std_loss_factor, ".3g"),
        strict=True,
    )
    modes = [
        {"mode": str(place), "frequency": frequency, "damping": loss}
        for place, (frequency, loss) in enumerate(rows, 1)
    ]
    return ModalView(number, test.job.test.name, modes, _list_matches(test))


def _format_values(values: RealArray, std: RealArray, form: str) -> list[str]:
    """Return numbers with their standard deviations, as far as either is known."""
    return [
        ("" if np.isnan(value) else f"{value:{form}}") + ("" if np.isnan(s) else f" ± {s:.2g}")
        for value, s in zip(values, std, strict=True)
    ]


@lru_cache(maxsize=2)
def assess_identifiability(path: Path, text: str) -> IdentifiabilityView:
    """Return the identifiability of the unknowns of a job at their start."""
    found = job_identifiability(_load_and_prepare(path, text))
    trades: dict[str, str] = {}
    for direction in found.null_directions:
        for name in direction:
            others = [other for other in direction if other != name]
            trades.setdefault(name, ", ".join(others))
    return IdentifiabilityView(
        found.rank, found.n_parameters, found.collinearity, trades, found.advice
    )


def check_job(path: Path, text: str) -> list[CheckRow]:
    """Return what is known of a job before any fit: identifiability, modes, faults of the data."""
    return [
        _check_identifiability(assess_identifiability(path, text)),
        *_check_modes(_load_and_prepare(path, text)),
        *_check_data(find_faults(path, text)),
    ]


def _check_identifiability(found: IdentifiabilityView) -> CheckRow:
    if found.rank == found.n:
        which = "the one unknown" if found.n == 1 else f"all {found.n} unknowns"
        return CheckRow(f"The data could determine {which}.")
    text = f"The data could determine {found.rank} of {found.n} combinations of the unknowns."
    return CheckRow(text, True, found.advice)


def _check_modes(ready: Prepared) -> list[CheckRow]:
    """Return how many modes of each test have a counterpart in the model."""
    rows = []
    for name, one in counterparts_at_start(ready, start_models(ready, ready.parameters)).items():
        statement = f"{name}: {one.statement}".removeprefix(": ")
        rows.append(CheckRow(statement, one.few, (one.remedy or REMEDY) if one.few else ""))
    return rows


def _check_data(rows: Sequence[FindingRow]) -> list[CheckRow]:
    if not rows:
        return [CheckRow("No known fault was found in the data.")]
    return [CheckRow(row.statement, True, row.remedy, row.repair, row.test) for row in rows]


def find_faults(path: Path, text: str) -> list[FindingRow]:
    """Return the suspected faults in the data of a job before any fit, the likeliest first."""
    ready = _load_and_prepare(path, text)
    found = []
    for number, test in enumerate(ready.tests):
        for each in job_findings(test, ready.parameters):
            row = FindingRow(
                each.statement,
                each.remedy,
                each.written,
                each.odds,
                number,
                _find_omissible(test, each),
                _view_repair(ready, test, each),
            )
            found.append(row)
    return sorted(found, key=lambda row: -row.odds)


def _find_omissible(test: PreparedTest, finding: Finding) -> dict[str, list[str]]:
    """Return the faulty sensors by key of ``[test]``; empty if no channel would be left."""
    if finding.concerns_model:
        return {}
    found = {}
    for key, role in (("responses", "response"), ("references", "reference")):
        faulty = {
            abs(Dof.parse(channel.removeprefix(FORCE)))
            for channel in finding.channels
            if channel.startswith(FORCE) == (role == "reference")
        }
        rows = [row for row in test.matching.table if role in row.role]
        sensors = [row.sensor for row in rows if abs(Dof.parse(row.dof)) in faulty]
        if len(sensors) == len(rows):
            return {}
        if sensors:
            found[key] = sensors
    return found


def _view_repair(ready: Prepared, test: PreparedTest, finding: Finding) -> RepairView | None:
    """Return the effect of a repair at the start; None if it keeps no values to compare."""
    if not finding.written or test.model.n_dofs > WEB_PAGE.quick_dofs:
        return None
    data = test.frf
    before = data.select(lines=data.freq[_choose_lines(data)])
    try:
        after = read_fault(finding.written).repair(before)
        model = respond_as_measured(_apply_values(ready, test.model, {}), before, before.freq)
    except UpdynError:
        return None
    if after.values.shape != before.values.shape or after.quantity != before.quantity:
        return None
    change = np.sum(np.abs(after.values - before.values) ** 2, axis=0)
    level = np.sum(np.abs(before.values) ** 2, axis=0)
    ratio = np.divide(change, level, out=np.zeros_like(change), where=level > 0.0)
    if not ratio.any():
        return None
    i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
    old, new, computed = (
        one.values[:, i, j].astype(np.complex64) for one in (before, after, model)
    )
    return RepairView(
        f"{data.responses.labels[i]} / {data.references.labels[j]}",
        before.freq,
        old,
        new,
        computed,
        float(relative_residual(before.values, model.values)[i, j]),
        float(relative_residual(after.values, model.values)[i, j]),
        unit(data.quantity, data.responses.labels[i], data.references.labels[j]),
    )


def count_counterparts(path: Path, text: str) -> list[str]:
    """Return a statement per test on the number of its modes with a counterpart in the model."""
    ready = _load_and_prepare(path, text)
    found = counterparts_at_start(ready, start_models(ready, ready.parameters))
    return [f"{name}: {one.statement}".removeprefix(": ") for name, one in found.items()]


def compute_model(
    path: Path,
    text: str,
    values: Mapping[str, float],
    number: int,
    responses: Sequence[str],
    references: Sequence[str],
) -> ModelView:
    """Return the model of a test at values of the unknowns; the others are at their start.

    `responses` and `references` are the labels in the file, as in `TestView`.
    """
    ready = _load_and_prepare(path, text)
    test = ready.tests[number]
    return _view_model(test, _apply_values(ready, test.model, values), responses, references)


def read_run(job: Path) -> JobView:
    """Read the job file of a folder of results, with its measurement."""
    return read_view(job, _read_text(job))


def compute_run_model(
    job: Path, number: int, responses: Sequence[str], references: Sequence[str]
) -> ModelView:
    """Return the updated model of a folder of results, for a test of its job file."""
    test = _load_and_prepare(job, _read_text(job)).tests[number]
    model = read_model(job.parent / test.name / "model.h5")
    return _view_model(test, model, responses, references)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read") from error


def _view_model(
    test: PreparedTest, model: Model, responses: Sequence[str], references: Sequence[str]
) -> ModelView:
    data = test.frf
    # A reduced model costs more than exact solutions at few lines, unless the model is large.
    tier = choose_tier(test) if model.n_dofs > WEB_PAGE.quick_dofs else None
    lines = data.freq[_choose_lines(data)]
    grid = fine_grid([fix_base(model, data)], lines, reduced=tier == "reduced")
    computed = respond_as_measured(model, data, grid, tier=tier, backend=test.job.method.backend)
    rows = _find_channels(test, responses, "response", data.responses.labels)
    columns = _find_channels(test, references, "reference", data.references.labels)
    repaired = None
    if test.job.test.repair:
        repaired = _arrange(data, rows, columns)
    fitted = test.fitted
    assert isinstance(fitted, FRF)
    fitted = fitted.select(lines=np.intersect1d(fitted.freq, lines))
    at_fitted = computed.select(lines=fitted.freq, responses=fitted.responses)
    return ModelView(
        grid,
        _arrange(computed, rows, columns),
        correlate(at_fitted, fitted).figures()["db_error_median"],
        data.freq,
        repaired,
    )


def _choose_lines(data: FRF) -> IndexArray:
    """Return the lines at which a model is compared with data, their peaks included."""
    return keep_lines(data.values, np.zeros(len(data.freq), dtype=bool), WEB_PAGE.model_lines)


def _find_channels(
    test: PreparedTest, labels: Sequence[str], role: str, known: Sequence[str]
) -> IndexArray:
    """Return the place of sensors among the known DOFs of the model; -1 if they are not there."""
    places = {abs(Dof.parse(label)): place for place, label in enumerate(known)}
    dofs = {
        abs(Dof.parse(row.sensor)): abs(Dof.parse(row.dof))
        for row in test.matching.table
        if role in row.role
    }
    found = [places.get(dofs.get(abs(Dof.parse(label))), -1) for label in labels]  # type: ignore[arg-type]
    return np.array(found, dtype=np.intp)


def _arrange(data: FRF, rows: IndexArray, columns: IndexArray) -> NDArray[np.complex64]:
    """Return values with the given channels; nan for those at -1."""
    values = np.pad(data.values.astype(np.complex64), ((0, 0), (0, 1), (0, 1)))
    values[:, -1] = np.nan
    values[:, :, -1] = np.nan
    return np.asarray(values[:, rows][:, :, columns])


def _apply_values(ready: Prepared, model: Model, values: Mapping[str, float]) -> Model:
    """Return a model at values of the unknowns; others have those of the start."""
    unknowns = ParameterSet(tuple(p for p in ready.parameters if not p.is_channel))
    x = np.array([values.get(p.name, p.start) for p in unknowns])
    return unknowns.apply(model, x) if len(unknowns) else model


def render_structure(path: Path, text: str, n_modes: int = 0) -> str:
    """Return the viewer of the model with sensors, forces and the lowest modes, as HTML.

    Sensors and forces are left out if they are not matched.
    """
    job = load_job(path, text=text)
    sensors: list[Dof] = []
    forces: list[Dof] = []
    try:
        ready = _load_and_prepare(path, text)
    except UpdynError:
        model, _ = prepare_model(job)
    else:
        data = ready.tests[0].data
        model = _apply_values(ready, ready.tests[0].model, {})
        if isinstance(data, FRF):
            sensors, forces = list(data.responses), list(data.references)
    shown_modes = modes(model, min(n_modes, model.n_dofs)) if n_modes else None
    shown = page(model_scene(model, shown_modes, responses=sensors, references=forces))
    return shown.replace("</body>", f"<script>{FORWARD}</script></body>")


#: What an embedded page says of a pick to the page around it.
FORWARD = """document.addEventListener("updyn-pick", ({ detail }) => {
  parent.postMessage({ updynPick: { label: detail.label, groups: detail.groups,
    sensors: detail.sensors, forces: detail.forces } }, "*");
});"""


def propose_job(model: Path, measurement: Path, job: Path, options: dict[str, object]) -> str:
    """Return a commented job (TOML) for a model and a measurement; it is not written.

    `options` has values that the files lack: ``quantity``, ``scale``, ``unit``; None if not given.
    """
    given = {name: value for name, value in options.items() if value is not None}
    of_model = {name: value for name, value in given.items() if name == "unit"}
    of_test = {name: value for name, value in given.items() if name != "unit"}
    inputs = read_inputs(model, measurement, of_model, of_test)
    if not inputs.has_quantity:
        raise InputError(f"{measurement.name} does not state the measured quantity; choose one")
    return job_text(inputs, job, f"{inputs.model.n_dofs} DOFs", f"{len(inputs.frf.freq)} lines")
