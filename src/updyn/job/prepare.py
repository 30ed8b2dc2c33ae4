"""`prepare`: read the files of a job, match its sensors to DOFs and select its unknowns."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.excitation import find_excitation
from updyn.dynamics.zero_line import leave_out_zero_line
from updyn.elements import MODEL_KINDS, MODEL_QUESTIONS
from updyn.errors import (
    DataError,
    DofError,
    InputError,
    JobError,
    OptionError,
    UpdynWarning,
    key_path,
)
from updyn.frf import FRF
from updyn.io import read_frf, read_geometry, read_model, read_modes, write_properties
from updyn.job.configuration import add_elements, apply_damping, configure_model
from updyn.job.files import existing_file, existing_measurement
from updyn.job.folder import RESERVED, outputs
from updyn.job.job_table import JOB_TABLES
from updyn.job.prepared import Prepared, PreparedTest
from updyn.job.recorded import estimate_from_records
from updyn.job.schema import Job, TestTable
from updyn.job.trace_lines import with_trace_lines
from updyn.job.unknowns import choose_unknowns
from updyn.linalg.solver import check_backend
from updyn.matching import MatchError, Matching, match
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.fit.methods import METHODS, check_quantity
from updyn.updating.fit.reducing import are_modes_reduced, is_reduced
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.problem.data import split_modes
from updyn.updating.problem.noise import average, choose_noise
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet

__all__ = [
    "match_measurement",
    "prepare",
    "prepare_model",
    "read_measurement",
    "relabel_modes",
]


def prepare(job: Job) -> Prepared:
    """Read and match the model and the measurements of a job, and select the unknowns.

    Parameters
    ----------
    job : Job
        From `load_job`.

    Returns
    -------
    Prepared

    Raises
    ------
    JobError
        If a file does not exist or cannot be read, a sensor is not a DOF of the model, a group is
        not in the model, or the like; the message gives the line of the job and the place in the
        file.
    """
    with job.located():
        model = add_elements(job, apply_damping(job, _build_model(job)))
    data: list[FRF | ModeSet] = []
    for part in job.parts:
        with part.located():
            data.append(_read_modes(part) if part.has_modes else read_measurement(part))
    tests: list[PreparedTest] = []
    for number, part in enumerate(job.parts):
        with part.located():
            tests.append(_prepare_test(part, model, data, number))
    with job.located():
        frfs = [test.data for test in tests if isinstance(test.data, FRF)]
        parameters = choose_unknowns(job, model, frfs)
        _check_properties(job, model, parameters)
        prepared = Prepared(job, tuple(tests), parameters)
        for name in job.tables:
            JOB_TABLES[name].check(prepared)
    _warn_of_doubts(job, tests)
    return prepared


def prepare_model(job: Job) -> tuple[Model, ParameterSet]:
    """Return the model of a job, configured as in its first test, and its unknowns."""
    with job.located():
        model = add_elements(job, apply_damping(job, _build_model(job)))
        return configure_model(job, model), choose_unknowns(job, model, [])


def _prepare_test(
    job: Job, model: Model, data: Sequence[FRF | ModeSet], number: int
) -> PreparedTest:
    others = [*data[:number], *data[number + 1 :]]
    matching = match_measurement(job, configure_model(job, model), data[number], others)
    if isinstance(matching.data, ModeSet):
        _check_table(matching.model, matching.data.frequency)
        _check_method(job, matching.data)
        fitted = _remove_validation_modes(job, matching.data)
        return PreparedTest(job, matching.model, matching.data, fitted, matching)
    frf = _apply_repairs(job, matching.model, _add_excitation(job, matching))
    frf = leave_out_zero_line(matching.model, frf, job.test.name)
    matching = replace(matching, data=frf)
    _check_table(matching.model, matching.frf.freq)
    fitted_frf = _remove_validation_set(job, matching.frf)
    _check_method(job, fitted_frf)
    return PreparedTest(
        job, matching.model, matching.frf, fitted_frf, matching, _read_matched_modes(job, matching)
    )


def _add_excitation(job: Job, matching: Matching) -> FRF:
    """Return the matched data with the base or the force of the job."""
    table, frf = job.test, matching.frf
    with key_path("test"):
        if table.base is not None or table.force is not None:
            frf = frf.with_excitation(table.base, table.force)
        find_excitation(matching.model.dofs, frf)
    return frf


def _check_table(model: Model, freq: RealArray) -> None:
    """Check that loss factors over frequency cover the data."""
    for name, group in model.groups.items():
        if group.loss_table is not None:
            with key_path("test", "band"):
                group.loss_table.at(freq, name)


def _apply_repairs(job: Job, model: Model, frf: FRF) -> FRF:
    """Return the matched data with the repairs of the job applied in turn."""
    with key_path("test", "repair"):
        for written in job.test.repair or ():
            frf = read_fault(written).repair(frf)
        model.dofs.match(frf.responses, "response")
    return frf


# -- model and measurement -------------------------------------------------------------------------
def _build_model(job: Job) -> Model:
    table = job.model
    if table.kind is not None:
        with key_path("model"):
            model = MODEL_KINDS[table.kind](table.keys)
            return model if table.groups is None else model.merge_groups(table.groups)
    assert table.file is not None
    path = existing_file(job, table.file, "model", "file")
    with key_path("model", otherwise=("file",)):
        return read_model(path, format=table.format, groups=table.groups, **table.keys)


def _warn_of_doubts(job: Job, tests: Sequence[PreparedTest]) -> None:
    """Warn about keys of ``[model]`` that are doubtful in the band of the tests."""
    kind = job.model.kind
    if kind is None or kind not in MODEL_QUESTIONS:
        return
    freq = np.concatenate([test.freq for test in tests])
    band = (float(freq.min()), float(freq.max()))
    for question in MODEL_QUESTIONS[kind](job.model.keys, band):
        warnings.warn(f"[model] {question}", UpdynWarning, stacklevel=2)


def _check_properties(job: Job, model: Model, parameters: ParameterSet) -> None:
    """Check that the properties of the model's source can be written, by a trial write."""
    name = job.output.properties
    if name is None:
        return
    with key_path("output", "properties"):
        if job.model.file is None:
            raise OptionError(
                "output.properties: a model built from the job has no deck; use model.h5 instead"
            )
        if Path(name).name != name or name in (*outputs(job)[1:], *RESERVED):
            raise OptionError(
                f"output.properties = {name!r}: expected a file name that no other output has"
            )
        deck = job.beside(job.model.file)
        changes = model.split_changes(parameters.changes(parameters.upper))
        with tempfile.TemporaryDirectory(prefix="updyn-properties-") as folder:
            try:
                write_properties(changes, deck, Path(folder) / name, format=job.model.format)
            except OSError as error:  # not a valid file name
                text = f"output.properties = {name!r}: {error.strerror}"
                raise OptionError(text) from error


def read_measurement(job: Job) -> FRF:
    """Return the measurement of one test in its band, averaged over repeats, with file labels."""
    table = job.test
    recorded = None
    if table.file is None:
        frf, recorded = _estimate_from_records(job)
    else:
        frf = _read_frf(job, table.file, "file")
    if table.repeats is not None:
        if table.averages is not None:
            text = "test.averages: with repeats the variance comes from them; leave it out"
            raise OptionError(text, key=("test", "averages"))
        repeats = [_read_frf(job, file, "repeats") for file in table.repeats]
        with key_path("test", "repeats"):
            frf = average([frf, *repeats])
    if table.averages is not None:
        if frf.averages not in (None, table.averages):
            text = (
                f"test.averages = {table.averages}, but {table.source} states {frf.averages};"
                " leave it out"
            )
            raise OptionError(text, key=("test", "averages"))
        frf = replace(frf, averages=table.averages)
    frf = _add_level(table, frf, recorded)
    with key_path("test"):
        return frf.select(band=table.band, exclude=table.exclude or ())


def _add_level(table: TestTable, frf: FRF, recorded: RealArray | None) -> FRF:
    """Return a measurement with the force of the job or of the records; refuse a contradiction."""
    given = (table.level, table.sweep, table.excitation, table.spectrum)
    if all(one is None for one in given):
        return frf
    names = "level", "sweep", "excitation", "spectrum"
    with key_path("test"):
        for key, value in zip(names, given, strict=True):
            stated = getattr(frf, key)
            if value is not None and stated is not None and not np.all(stated == np.array(value)):
                raise OptionError(
                    f"test.{key} = {value!r}, but {table.source} states the {frf.level_text}; leave"
                    " it out",
                    key=(key,),
                )
        excitation = table.excitation or frf.excitation
        level: float | RealArray | None = frf.level if table.level is None else table.level
        spectrum = frf.spectrum if table.spectrum is None else np.array(table.spectrum)
        if excitation == "random" and level is None and spectrum is None:
            spectrum = recorded
        return frf.with_level(level, table.sweep or frf.sweep, excitation, spectrum)


def _estimate_from_records(job: Job) -> tuple[FRF, RealArray | None]:
    """Return the FRFs of ``[records]`` and the spectrum of their force; warn for each fault."""
    assert job.records is not None
    found = estimate_from_records(job, job.records)
    for setup in found.setups:
        for one in setup.open_findings:
            text = f"{setup.name}: {one.statement} {one.remedy}"
            warnings.warn(text, UpdynWarning, stacklevel=2)
    with key_path("test"):
        frf = found.frf.select(responses=job.test.responses, references=job.test.references)
    return frf, found.spectrum


def _read_frf(job: Job, file: str, key: str) -> FRF:
    """Return the measurement in a file that a key of ``[test]`` names."""
    path = existing_measurement(job, file, key)
    with key_path("test", otherwise=(key,)):
        return read_frf(path, **job.test.reader_options)


def _read_matched_modes(job: Job, matching: Matching) -> ModeSet | None:
    """Return the modes that the test names in addition to FRFs; None if it names none."""
    if job.test.modes is None:
        return None
    modes = _read_modes(job)
    with key_path("test", "modes"):
        return relabel_modes(matching, modes)


def _read_modes(job: Job) -> ModeSet:
    """Return the measured modes of the test in its band, with the labels of the file."""
    table = job.test
    assert table.modes is not None
    path = existing_file(job, table.modes, "test", "modes")
    options = table.modes_reader or {}
    with _assign_option_key(options):
        modes = read_modes(path, **options)
    with key_path("test", "band"):
        return modes if table.band is None else modes.select(band=table.band)


@contextmanager
def _assign_option_key(options: Mapping[str, object]) -> Iterator[None]:
    """Assign errors of an option of the modes reader to its key, others to the file."""
    try:
        yield
    except InputError as error:
        of_option = error.key[0] in options if error.key else isinstance(error, OptionError)
        place = ("modes_reader", *error.key) if of_option else ("modes",)
        error.key = ("test", *place)
        raise


# -- fitted data -----------------------------------------------------------------------------------
def _remove_validation_set(job: Job, frf: FRF) -> FRF:
    """Return the data without the validation set."""
    held = job.validation
    if held is None:
        return frf
    with key_path(job.table_of("validation"), "validation"):
        if isinstance(held[0], str):
            at = frf.responses.match(held, "validation response").index
            rows = np.setdiff1d(np.arange(len(frf.responses)), at)
            if rows.size:
                return frf.select(responses=frf.responses[rows])
        else:
            low, high = frf.select(band=held).freq[[0, -1]]
            lines = frf.freq[(frf.freq < low) | (frf.freq > high)]
            if lines.size:
                return frf.select(lines=lines)
        raise DataError("validation holds out everything: nothing is left to fit")


def _remove_validation_modes(job: Job, modes: ModeSet) -> ModeSet:
    held = job.validation
    if held is None:
        return modes
    with key_path(job.table_of("validation"), "validation"):
        return split_modes(modes, held).fitted


def _check_method(job: Job, fitted: FRF | ModeSet) -> None:
    """Check tier, backend, noise and lines of ``[method]`` with the data."""
    method = job.method
    with key_path("method", "tier"):
        if isinstance(fitted, ModeSet):
            are_modes_reduced(method.tier, 0)
        else:
            is_reduced(method.tier, 0, 0, method.name)
    with key_path("method"):
        check_backend(method.backend)
        check_quantity(fitted, METHODS.find(method.name))
    if isinstance(fitted, ModeSet):
        with key_path(job.table_of("noise")):
            choose_modal_noise(job.noise)
        return
    # Without variance and coherence, an estimate takes long, and errors do not depend on the lines.
    is_estimated = fitted.variance is None and fitted.coherence is None
    few = fitted.select(lines=fitted.freq[:1]) if is_estimated else fitted
    with key_path(job.table_of("noise")):
        choose_noise(job.noise, few)
    if isinstance(method.lines, tuple):
        with key_path("method", "lines"):
            fitted.find_lines(method.lines)


# -- sensors ---------------------------------------------------------------------------------------
T = TypeVar("T")


def match_measurement(
    job: Job, model: Model, data: FRF | ModeSet, others: Sequence[FRF | ModeSet] = ()
) -> Matching:
    """Match the measurement of a job to its model, as in ``[match]``; `JobError` if impossible.

    Entries of ``[match]`` about sensors of `others`, the data of the other tests, are ignored.
    """
    table = job.match
    geometry = None
    if table.geometry is not None:
        path = existing_file(job, table.geometry, "match", "geometry")
        with key_path("match", "geometry"):
            geometry = read_geometry(path)
    alignment = table.alignment
    if isinstance(alignment, dict):
        alignment = {int(node): other for node, other in alignment.items()}
    try:
        matching = match(
            model,
            data,
            geometry,
            by=table.by,
            tolerance=table.tolerance,
            unit=table.unit,
            alignment=alignment,
            angle=table.angle,
            table=_select_entries(table.table, data, others),
            directions=_select_entries(table.directions, data, others),
        )
    except MatchError as error:
        raise _reword_match_error(job, error) from error
    other_nodes = {int(name) for other in others for name in _list_sensors(other) if name.isdigit()}
    return with_trace_lines(matching, table.lines or (), other_nodes)


def relabel_modes(matching: Matching, modes: ModeSet) -> ModeSet:
    """Return modes with the DOF labels of the model.

    DOFs that the FRFs also have are matched as their sensors and forces; others must have labels of
    the model.
    """
    rows = {row.sensor: row for row in matching.table}
    named = []
    for dof in modes.dofs:
        row = rows.get(str(Dof(dof.node, dof.direction)))
        if row is None:
            named.append(dof)
            continue
        if row.turned:
            raise DofError(
                f"DOF {dof} of the modes: its sensor is oblique, and the axes of its node in"
                " the model are rotated along it"
            )
        of_model = Dof.parse(row.dof)
        named.append(of_model if dof.sign > 0 else -of_model)
    dofs = DofSet(named)
    matching.model.dofs.match(dofs, "DOF of the modes")
    return modes.renamed(dofs)


def _select_entries(
    entries: Mapping[str, T], data: FRF | ModeSet, others: Sequence[FRF | ModeSet]
) -> dict[str, T]:
    """Return the sensor entries without those of sensors that only other tests have."""
    other_names: set[str] = set()
    for other in others:
        other_names |= _list_sensors(other)
    other_names -= _list_sensors(data)
    unsigned = str.maketrans("", "", "+-")
    return {
        label: value
        for label, value in entries.items()
        if label.translate(unsigned) not in other_names
    }


def _list_sensors(data: FRF | ModeSet) -> set[str]:
    """Return the names of the sensors and forces, by DOF and by node."""
    names: set[str] = set()
    dofs = data.dofs if isinstance(data, ModeSet) else (*data.responses, *data.references)
    for dof in dofs:
        names |= {f"{dof.node}:{dof.direction}", str(dof.node)}
    return names


def _reword_match_error(job: Job, error: MatchError) -> JobError:
    text = str(error).replace("the measurement", job.test.source)
    text = text.replace(" in table", " in [match.table]")
    if error.key == ("by",):
        text = text.replace("coordinates (by = ", "coordinates ([match] by = ")
        text = text.replace('tolerance = "any"', '[match] tolerance = "any"')
    if error.lost:
        text += (
            f'\nGive each its label in the model under [match.table] ("{error.lost[0]}" = "..."),'
            " or keep only those that are, with responses and references in [test]"
        )
    in_match = error.key and job.place("match") is not None
    return JobError(text, key=("match", *error.key) if in_match else ("test", "file"))
