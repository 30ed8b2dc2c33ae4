"""Content of the pages about a job, as plain data: read, matched and solved in a `Desk`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import Dof
from updyn.dynamics.modes import modes
from updyn.dynamics.response import response as model_response
from updyn.errors import InputError, UpdynError
from updyn.frf import FRF
from updyn.job import Job, Prepared, job_findings, job_identifiability, load_job, prepare
from updyn.job.prepare import read_measurement
from updyn.job.prepared import PreparedTest
from updyn.job.proposal import job_text, read_inputs
from updyn.job.start import counterparts_at_start
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet
from updyn.viewer import model_scene, page

__all__ = [
    "CHOICES",
    "FORWARD",
    "ChannelCurve",
    "FindingRow",
    "IdentifiabilityView",
    "JobView",
    "ModalView",
    "TestView",
    "UnknownRow",
    "assess_identifiability",
    "compute_curve",
    "count_counterparts",
    "find_faults",
    "propose_job",
    "read_view",
    "render_structure",
]

T = TypeVar("T")

#: Quantities of a group that are chosen by a click.
CHOICES = ("stiffness", "mass", "loss_factor")
#: Lines at which a page shows the model.
_MOST_LINES = 400


@dataclass(frozen=True, slots=True, eq=False)
class TestView:
    """One test as measured, before its band.

    Attributes
    ----------
    number : int
        Which test of the job it is.
    name : str
        Name of the test; empty for a single test.
    quantity : str
        Measured quantity.
    freq : ndarray of float, shape (n_lines,)
        Lines in Hz.
    values : ndarray of complex, shape (n_lines, n_responses, n_references)
        The FRFs, in SI.
    responses, references : list of str
        Their labels in the file.
    used : ndarray of bool, shape (n_lines,)
        Lines that band and exclusions leave.
    band : (float, float) or None
        Of the job, in Hz.
    matches : list of mapping of str to str
        Sensors with their DOFs; empty if they could not be matched.
    held : list of str
        Responses that are held out of the fit, as the job writes them: labels of the model.
    held_band : (float, float) or None
        The band in Hz that is held out in their place.
    holdable : mapping of str to str
        Responses that can be held out, by the label in the job: the labels of the model with their
        sensors, or those of `held` if the sensors are not matched.
    coherence : ndarray of float, shape of `values`, or None
        The coherence, if the file contains it.
    """

    number: int
    name: str
    quantity: str
    freq: NDArray[np.float64]
    values: NDArray[np.complex64]
    responses: list[str]
    references: list[str]
    used: NDArray[np.bool_]
    band: tuple[float, float] | None
    matches: list[dict[str, str]]
    held: list[str]
    held_band: tuple[float, float] | None
    holdable: Mapping[str, str]
    coherence: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True)
class ModalView:
    """One test whose data are modes.

    Attributes
    ----------
    number : int
        Which test of the job it is.
    name : str
        Name of the test; empty for a single test.
    modes : list of mapping of str to str
        ``mode``, ``frequency`` in Hz and ``damping`` of each mode in the band, with known standard
        deviations.
    matches : list of mapping of str to str
        Sensors with their DOFs.
    """

    number: int
    name: str
    modes: list[dict[str, str]]
    matches: list[dict[str, str]]


@dataclass(frozen=True, slots=True)
class UnknownRow:
    """An unknown of a job.

    Attributes
    ----------
    name, group, quantity : str
        Which one it is.
    start, lower, upper : float
        In its unit.
    """

    name: str
    group: str
    quantity: str
    start: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False)
class JobView:
    """A job as far as it can be read.

    Attributes
    ----------
    title : str
        Of the job.
    model : str
        The model in a few words.
    groups : list of str
        Its groups.
    groups_by_quantity : mapping of str to list of str
        The groups that have a quantity, by the quantities of `CHOICES`.
    tests : list of TestView
        Its tests with FRFs.
    modal : list of ModalView
        Its tests with modes that could be read and matched.
    unknowns : list of UnknownRow
        Those of the job.
    errors : mapping of str to str
        Errors of reading and matching, by part: ``"job"``, ``"test"``, ``"all"``.
    has_picture : bool
        Whether the model has a geometry, by which it can be drawn.
    """

    title: str
    model: str
    groups: list[str]
    groups_by_quantity: Mapping[str, list[str]]
    tests: list[TestView]
    modal: list[ModalView]
    unknowns: list[UnknownRow]
    errors: Mapping[str, str]
    has_picture: bool = False


@dataclass(frozen=True, slots=True)
class IdentifiabilityView:
    """What the data could determine of the unknowns.

    Attributes
    ----------
    rank, n : int
        Combinations that are determined, and unknowns.
    collinearity : float
        Brun's index.
    undetermined : mapping of str to str
        The unknowns that are not determined, with those they trade against.
    advice : str
        What to do.
    """

    rank: int
    n: int
    collinearity: float
    undetermined: Mapping[str, str]
    advice: str


@dataclass(frozen=True, slots=True)
class FindingRow:
    """Something that seems to be wrong with the data or the model.

    Attributes
    ----------
    statement, remedy : str
        The finding, and its remedy.
    repair : str
        Entry of ``repair`` in the job that corrects it; empty if it cannot.
    odds : float
        Its odds.
    test : int
        Which test.
    """

    statement: str
    remedy: str
    repair: str
    odds: float
    test: int


@dataclass(frozen=True, slots=True, eq=False)
class ChannelCurve:
    """One channel of the model.

    Attributes
    ----------
    freq : ndarray of float, shape (n,)
        Lines in Hz.
    values : ndarray of complex, shape (n,)
        The FRF in the quantity of the test, in SI.
    """

    freq: NDArray[np.float64]
    values: NDArray[np.complex128]


@lru_cache(maxsize=2)
def _load_and_prepare(path: Path, text: str) -> Prepared:
    return prepare(load_job(path, text=text))


def read_view(path: Path, text: str) -> JobView:
    """Read a job and all its files; errors replace parts that cannot be read.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.

    Returns
    -------
    View
    """
    errors: dict[str, str] = {}
    job = _try_part(lambda: load_job(path, text=text), "job", errors)
    if job is None:
        return JobView("", "", [], {}, [], [], [], errors)
    ready = _try_part(lambda: _load_and_prepare(path, text), "all", errors)
    tests = []
    for number, part in enumerate(job.parts):
        if not part.has_modes:
            view = _try_part(
                lambda part=part, at=number: _view_test(part, at, ready),  # type: ignore[misc]
                "test",
                errors,
            )
            tests += [] if view is None else [view]
    if ready is None:
        return JobView(job.title or path.stem, "", [], {}, tests, [], [], errors)
    model = ready.model
    about = f"{model.n_dofs:,} DOFs in {len(model.groups)} groups"
    unknowns = [
        UnknownRow(p.name, p.group, p.quantity, p.start, p.lower, p.upper) for p in ready.parameters
    ]
    groups = list(model.groups)
    title = job.title or path.stem
    modal = [
        _view_modes(test, number)
        for number, test in enumerate(ready.tests)
        if isinstance(test.data, ModeSet)
    ]
    drawn = model.geometry is not None
    return JobView(
        title, about, groups, _find_groups_by_quantity(model), tests, modal, unknowns, errors, drawn
    )


def _find_groups_by_quantity(model: Model) -> dict[str, list[str]]:
    """Return the groups of a model that have each quantity of `CHOICES`."""
    stiff = [name for name, group in model.groups.items() if group.stiffness is not None]
    heavy = [name for name, group in model.groups.items() if group.mass is not None]
    return {"stiffness": stiff, "mass": heavy, "loss_factor": stiff}


def _try_part(make: Callable[[], T], what: str, errors: dict[str, str]) -> T | None:
    """Return the result of a function, or None after storing its error in `errors`."""
    try:
        return make()
    except UpdynError as error:
        errors.setdefault(what, str(error))
        return None


def _view_test(part: Job, number: int, ready: Prepared | None) -> TestView:
    """Return a test over all its lines."""
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
    """Return the sensors with their DOFs."""
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
    """Return a test whose data are modes."""
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


def _format_values(values: NDArray[np.float64], std: NDArray[np.float64], form: str) -> list[str]:
    """Return numbers with their standard deviations, as far as either is known."""
    return [
        ("" if np.isnan(value) else f"{value:{form}}") + ("" if np.isnan(s) else f" ± {s:.2g}")
        for value, s in zip(values, std, strict=True)
    ]


def assess_identifiability(path: Path, text: str) -> IdentifiabilityView:
    """Return which unknowns the data of a job could determine.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.

    Returns
    -------
    Separability
    """
    found = job_identifiability(_load_and_prepare(path, text))
    trades: dict[str, str] = {}
    for direction in found.null_directions:
        for name in direction:
            others = [other for other in direction if other != name]
            trades.setdefault(name, ", ".join(others))
    return IdentifiabilityView(
        found.rank, found.n_parameters, found.collinearity, trades, found.advice
    )


def find_faults(path: Path, text: str) -> list[FindingRow]:
    """Return the suspected faults in the data of a job, before any fit.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.

    Returns
    -------
    list of FindingRow
        The likeliest first.
    """
    ready = _load_and_prepare(path, text)
    found = []
    for number, test in enumerate(ready.tests):
        for each in job_findings(test, ready.parameters):
            row = FindingRow(each.statement, each.remedy, each.written, each.odds, number)
            found.append(row)
    return sorted(found, key=lambda row: -row.odds)


def count_counterparts(path: Path, text: str) -> list[str]:
    """Return for each test how many of its modes have a counterpart in the model.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.

    Returns
    -------
    list of str
        A statement for each test.
    """
    ready = _load_and_prepare(path, text)
    found = counterparts_at_start(ready, ready.parameters)
    return [f"{name}: {one.statement}".removeprefix(": ") for name, one in found.items()]


def compute_curve(
    path: Path, text: str, values: Mapping[str, float], test: int, response: int, reference: int
) -> ChannelCurve:
    """Return one channel of the model at values of the unknowns.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.
    values : mapping of str to float
        The unknowns, by name; others stay at their start.
    test, response, reference : int
        Which test, and which channel of its data.

    Returns
    -------
    Curve
        At the lines of the band, or at evenly spaced ones among them.
    """
    ready = _load_and_prepare(path, text)
    prepared_test = ready.tests[test]
    data: FRF = prepared_test.frf
    freq = data.freq[:: max(1, len(data.freq) // _MOST_LINES)]
    model = _apply_values(ready, prepared_test.model, values)
    shown = model_response(
        model,
        freq,
        responses=[data.responses.labels[response]],
        references=[data.references.labels[reference]],
        quantity=data.quantity,
    )
    return ChannelCurve(shown.freq, shown.values[:, 0, 0])


def _apply_values(ready: Prepared, model: Model, values: Mapping[str, float]) -> Model:
    """Return a model at values of the unknowns; others have those of the start."""
    unknowns = ParameterSet(tuple(p for p in ready.parameters if not p.is_channel))
    x = np.array([values.get(p.name, p.start) for p in unknowns])
    return unknowns.apply(model, x) if len(unknowns) else model


def render_structure(path: Path, text: str, n_modes: int = 0) -> str:
    """Return the viewer of the model with sensors and forces as a page.

    Parameters
    ----------
    path : Path
        The job file.
    text : str
        Its text.
    n_modes : int
        Largest number of the lowest modes at the start values to animate.

    Returns
    -------
    str
        HTML.
    """
    ready = _load_and_prepare(path, text)
    prepared_test = ready.tests[0]
    data = prepared_test.data
    sensors, forces = ([], []) if not isinstance(data, FRF) else (data.responses, data.references)
    model = _apply_values(ready, prepared_test.model, {})
    shown_modes = modes(model, min(n_modes, model.n_dofs)) if n_modes else None
    scene = model_scene(model, shown_modes, responses=list(sensors), references=list(forces))
    shown = page(scene)
    return shown.replace("</body>", f"<script>{FORWARD}</script></body>")


#: What an embedded page says of a pick to the page around it.
FORWARD = """document.addEventListener("updyn-pick", ({ detail }) => {
  parent.postMessage({ updynPick: { label: detail.label, groups: detail.groups,
    sensors: detail.sensors, forces: detail.forces } }, "*");
});"""


def propose_job(model: Path, measurement: Path, job: Path, options: dict[str, object]) -> str:
    """Return a commented job for a model and a measurement.

    Parameters
    ----------
    model, measurement, job : Path
        The files; that of the job is not written.
    options : dict of str to object
        Values missing in the files: ``quantity``, ``scale``, ``unit``; None if not stated.

    Returns
    -------
    str
        TOML.
    """
    inputs = read_inputs(model, measurement, options)
    return job_text(inputs, job, f"{inputs.model.n_dofs} DOFs", f"{len(inputs.frf.freq)} lines")
