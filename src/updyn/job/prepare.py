"""`prepare`: read what a job names, match sensors to DOFs, choose the unknowns."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import DataError, InputError, JobError, OptionError, suggest
from updyn.frf import FRF
from updyn.job.matched import matched
from updyn.job.schema import KINDS, OUTPUTS, Job
from updyn.matching import Matching
from updyn.model import Model
from updyn.updating.choice import link, parameters
from updyn.updating.parameters import Parameter, ParameterSet

__all__ = ["Prepared", "PreparedTest", "prepare"]

_QUANTITY_ORDER = ("mass", "stiffness", "loss_factor", "viscous")


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTest:
    """One test of a job, with its configuration of the model.

    Attributes
    ----------
    job : Job
        The job, with this test.
    model : Model
        Where the update starts; DOFs of nodes with oblique sensors are turned along them.
    frf : FRF
        The data in the job's band, named as the model names its DOFs.
    fitted : FRF
        Of these, what is fitted: all but what is held out for validation.
    matching : Matching
        Who sits where.
    """

    job: Job
    model: Model
    frf: FRF
    fitted: FRF
    matching: Matching

    @property
    def name(self) -> str:
        """What the test is called; empty where it is the only one."""
        return self.job.test.name


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A job with all that it names, ready to run.

    Attributes
    ----------
    job : Job
        The job.
    tests : tuple of PreparedTest
        Its tests.
    parameters : ParameterSet
        The unknowns.
    """

    job: Job
    tests: tuple[PreparedTest, ...]
    parameters: ParameterSet

    @property
    def model(self) -> Model:
        """The model of the first test."""
        return self.tests[0].model

    @property
    def frf(self) -> FRF:
        """The data of the first test."""
        return self.tests[0].frf

    @property
    def fitted(self) -> FRF:
        """What is fitted of the first test."""
        return self.tests[0].fitted

    @property
    def matching(self) -> Matching:
        """Who sits where in the first test."""
        return self.tests[0].matching


def prepare(job: Job) -> Prepared:
    """Read the model and the measurements of a job, match them, and choose the unknowns.

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
        If a file is not there or cannot be read, a sensor is not a DOF of the model, a group is not in the model, or
        the like; the message says on which line of the job, and where in the file.
    """
    model = _model(job)
    _check_properties(job)
    data = [_measurement(part) for part in job.parts]
    tests = tuple(_test(part, model, data, i) for i, part in enumerate(job.parts))
    return Prepared(job, tests, _parameters(job, model))


def _test(job: Job, model: Model, data: Sequence[FRF], number: int) -> PreparedTest:
    others = [frf for i, frf in enumerate(data) if i != number]
    matching = matched(job, _configured(job, model), data[number], others)
    fitted = _fitted(job, matching.frf)
    _check_method(job, fitted)
    return PreparedTest(job, matching.model, matching.frf, fitted, matching)


@contextmanager
def _at(job: Job, *place: str | int) -> Iterator[None]:
    """Give an error the line of the job that it belongs to."""
    try:
        yield
    except JobError:
        raise
    except InputError as error:
        raise job.error(str(error), *place) from error


# -- model and measurement ---------------------------------------------------------------------------------
def _model(job: Job) -> Model:
    table = job.model
    if table.kind is not None:
        module, function = KINDS[table.kind]
        try:
            model = getattr(importlib.import_module(module), function)(table.keys)
        except InputError as error:
            raise job.error_about(str(error), "model") from error
        assert isinstance(model, Model)
        return model
    from updyn.io import read_model

    assert table.file is not None
    path = _existing(job, table.file, "model")
    try:
        return read_model(path, format=table.format, **table.keys)
    except OptionError as error:
        key = next(iter(k for k in table.keys if repr(k) in str(error)), "file")
        raise job.error(str(error), "model", key) from error
    except InputError as error:
        raise job.error(str(error), "model", "file") from error


def _check_properties(job: Job) -> None:
    """Check that the properties of the model's source can be written, before anything is computed."""
    if job.output.properties is None:
        return
    from updyn.io.registry import find_format

    with _at(job, "output", "properties"):
        if job.model.file is None:
            raise OptionError("output.properties: a model that was built here has no deck; write it to model.h5")
        if Path(job.output.properties).name != job.output.properties or job.output.properties in OUTPUTS:
            raise OptionError(f"output.properties = {job.output.properties!r}: expected the name of a file of its own")
        find_format(job.beside(job.model.file), "write_properties", job.model.format)


def _configured(job: Job, model: Model) -> Model:
    """Return the model as it stands in the job's test: with what was added to it, and held."""
    from updyn.elements.constraints import add_masses, constrain

    if job.test.masses:
        with _at(job, "test", "masses"):
            model = add_masses(model, job.test.masses)
    if job.test.grounded:
        with _at(job, "test", "grounded"):
            model = constrain(model, grounded=job.test.grounded)
    return model


def _measurement(job: Job) -> FRF:
    from updyn.io import read_frf

    table = job.test
    path = _existing(job, table.file, "test")
    try:
        frf = read_frf(path, **table.reader_options)
    except InputError as error:
        raise job.error_about(str(error), "test", path=path) from error
    if table.averages is not None:
        if frf.averages not in (None, table.averages):
            raise job.error(
                f"test.averages = {table.averages}, but {table.file} says {frf.averages}; leave it out",
                "test",
                "averages",
            )
        frf = replace(frf, averages=table.averages)
    with _at(job, "test", "band"):
        return frf.select(band=table.band)


def _existing(job: Job, file: str, table: str) -> Path:
    path = job.beside(file)
    if path.is_file():
        return path
    if path.is_dir():
        raise job.error(f"{table}.file = {file!r} is a folder ({path})", table, "file")
    siblings = [p.name for p in path.parent.iterdir() if p.is_file()] if path.parent.is_dir() else []
    hint = suggest(path.name, siblings) if siblings else f"the folder {str(path.parent)!r} is empty or does not exist"
    raise job.error(f"{table}.file = {file!r}: no such file; {hint}", table, "file")


# -- what is fitted ----------------------------------------------------------------------------------------
def _fitted(job: Job, frf: FRF) -> FRF:
    held = job.validation
    if held is None:
        return frf
    with _at(job, "method" if job.test.validation is None else "test", "validation"):
        if isinstance(held[0], str):
            at = frf.responses.match(held, "validation response").index
            keep = np.setdiff1d(np.arange(len(frf.responses)), at)
            rest = None if keep.size == 0 else frf.select(responses=frf.responses[keep])
        else:
            low, high = frf.select(band=held).freq[[0, -1]]
            kept = frf.freq[(frf.freq < low) | (frf.freq > high)]
            rest = None if kept.size == 0 else frf.select(lines=kept)
        if rest is None:
            raise DataError("validation holds out everything: nothing is left to fit")
    return rest


def _check_method(job: Job, fitted: FRF) -> None:
    from updyn.dynamics.fields import TIERS
    from updyn.linalg.factorise import check_backend
    from updyn.updating.noise import choose_noise
    from updyn.updating.reducing import is_reduced

    if job.method.tier is not None and job.method.tier not in TIERS:
        raise job.error(f"tier {job.method.tier!r}: {suggest(job.method.tier, TIERS)}", "method", "tier")
    with _at(job, "method", "tier"):
        is_reduced(job.method.tier, 0, 0, job.method.name)
    with _at(job, "method", "backend"):
        check_backend(job.method.backend)
    with _at(job, "method" if job.test.noise is None else "test", "noise"):
        choose_noise(job.noise, fitted)
    if isinstance(job.method.lines, tuple):
        with _at(job, "method", "lines"):
            fitted.find_lines(job.method.lines)


def _parameters(job: Job, model: Model) -> ParameterSet:
    chosen: dict[str, tuple[int, Parameter]] = {}
    for number in range(len(job.parameter)):
        try:
            items = _choose(job, model, number)
        except JobError:
            raise
        except InputError as error:
            raise job.error_about(str(error), "parameter", number) from error
        for p in items:
            if p.name in chosen:
                first = job.place("parameter", chosen[p.name][0])
                raise job.error(
                    f"{p.name} is already an unknown of the [[parameter]] on line {first}", "parameter", number
                )
            chosen[p.name] = (number, p)
    groups = list(model.groups)

    def place(entry: tuple[int, Parameter]) -> tuple[int, int]:
        number, p = entry
        if p.drives:  # after the others, as the job has them
            return len(groups), number
        return groups.index(p.group), _QUANTITY_ORDER.index(p.quantity)

    with _at(job, "parameter"):
        return ParameterSet(tuple(p for _, p in sorted(chosen.values(), key=place)))


def _choose(job: Job, model: Model, number: int) -> Sequence[Parameter]:
    table = job.parameter[number]
    if table.name is not None and table.drives is not None:
        with _at(job, "parameter", number, "drives"):
            return link(
                model,
                table.name,
                table.drives,
                start=table.start,
                bounds=table.bounds,
                prior_std=table.prior_std,
                nominal=table.nominal,
                unit=table.unit,
            )
    assert table.quantity is not None and table.groups is not None  # noqa: PT018 (the schema saw to it)
    quantity, bounds = table.quantity, table.bounds
    groups = "all" if table.groups == ("all",) and "all" not in model.groups else table.groups
    chosen: dict[str, Any] = {quantity: groups}
    with _at(job, "parameter", number, "groups"):
        items: Sequence[Parameter] = parameters(model, **chosen)
    if bounds is not None and table.start is None:  # may move the start of a loss factor onto a bound
        items = parameters(model, **chosen, bounds={quantity: bounds})
    elif table.start is not None:
        items = [
            replace(
                p, start=table.start, lower=bounds[0] if bounds else p.lower, upper=bounds[1] if bounds else p.upper
            )
            for p in items
        ]
    return [replace(p, prior_std=table.prior_std, nominal=table.nominal, unit=table.unit) for p in items]
