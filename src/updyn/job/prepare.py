"""`prepare`: read what a job names, match sensors to DOFs, choose the unknowns."""

from __future__ import annotations

import fnmatch
import importlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import DataError, InputError, JobError, OptionError, suggest
from updyn.frf import FRF
from updyn.group import GROUP_QUANTITIES
from updyn.job.matched import matched, matched_modes
from updyn.job.schema import KINDS, OUTPUTS, Job
from updyn.matching import Matching
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.channels import calibration, check_method
from updyn.updating.choice import link, parameters
from updyn.updating.methods import method_class
from updyn.updating.noise import average
from updyn.updating.parameters import Parameter, ParameterSet

__all__ = ["Prepared", "PreparedTest", "prepare"]

_QUANTITY_ORDER = ("mass", "stiffness", "loss_factor", "viscous", "mass_damping", "stiffness_damping")


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
    modes : ModeSet or None
        The modes that the job names, named as the model names its DOFs.
    """

    job: Job
    model: Model
    frf: FRF
    fitted: FRF
    matching: Matching
    modes: ModeSet | None = None

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
    def modes(self) -> dict[str, ModeSet]:
        """The modes that the job names, by the names of their tests."""
        return {test.name: test.modes for test in self.tests if test.modes is not None}

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
    model = _damped(job, _model(job))
    _check_properties(job)
    data = [_measurement(part) for part in job.parts]
    tests = tuple(_test(part, model, data, i) for i, part in enumerate(job.parts))
    chosen = _parameters(job, model)
    return Prepared(job, tests, _with_calibration(job, chosen, [test.frf for test in tests]))


def _test(job: Job, model: Model, data: Sequence[FRF], number: int) -> PreparedTest:
    others = [frf for i, frf in enumerate(data) if i != number]
    matching = matched(job, _configured(job, model), data[number], others)
    for name, group in matching.model.groups.items():
        if group.loss_table is not None:
            with _at(job, "test", "band"):
                group.loss_table.at(matching.frf.freq, name)
    fitted = _fitted(job, matching.frf)
    _check_method(job, fitted)
    return PreparedTest(job, matching.model, matching.frf, fitted, matching, _modes(job, matching))


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


def _damped(job: Job, model: Model) -> Model:
    """Return the model with the damping that the job begins with; a later table wins."""
    for number, table in enumerate(job.damping):
        acting = {"loss_factor" if name == "loss_table" else name for name in table.stated}
        able = {name for name, group in model.groups.items() if all(group.has(q) for q in acting)}
        names: list[str] = []
        for pattern in table.groups:
            fits = [n for n in model.groups if fnmatch.fnmatchcase(n, pattern) or pattern == "all"]
            if not fits:
                text = f"damping: no group {pattern!r}; {suggest(pattern, model.groups)}"
                raise job.error(text, "damping", number, "groups")
            if pattern in model.groups or not able.intersection(fits):
                names += fits  # and if there is nothing to act on, that is said
            names += able.intersection(fits)
        try:
            model = model.with_damping({name: table.stated for name in model.groups if name in names})
        except InputError as error:
            raise job.error_about(str(error), "damping", number) from error
    return model


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
    from updyn.elements.constraints import constrain

    model = _loaded(job, model)
    if job.test.grounded:
        with _at(job, "test", "grounded"):
            model = constrain(model, grounded=job.test.grounded)
    return model


def _loaded(job: Job, model: Model) -> Model:
    """Return the model with the masses of the job's test."""
    from updyn.elements.constraints import add_masses
    from updyn.elements.sensor_masses import add_sensor_masses

    if job.test.masses:
        with _at(job, "test", "masses"):
            model = add_masses(model, job.test.masses)
    if job.test.sensor_masses:
        with _at(job, "test", "sensor_masses"):
            model = add_sensor_masses(model, job.test.sensor_masses)
    return model


def _with_all_masses(job: Job, model: Model) -> Model:
    """Return the model with the masses of all tests, for unknowns to name them."""
    groups = dict(model.groups)
    for part in job.parts:
        groups = dict(_loaded(part, model).groups) | groups
    order = [*model.groups, *(name for name in groups if name not in model.groups)]
    return Model({name: groups[name] for name in order}, model.dofs, model.geometry, model.title)


def _measurement(job: Job) -> FRF:
    table = job.test
    frf = _read(job, table.file, "file")
    if table.repeats is not None:
        if table.averages is not None:
            told = "test.averages: with repeats the variance comes from them; leave it out"
            raise job.error(told, "test", "averages")
        repeats = [_read(job, file, "repeats") for file in table.repeats]
        with _at(job, "test", "repeats"):
            frf = average([frf, *repeats])
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


def _read(job: Job, file: str, key: str) -> FRF:
    from updyn.io import read_frf

    path = _existing(job, file, "test", key)
    try:
        return read_frf(path, **job.test.reader_options)
    except InputError as error:
        raise job.error_about(str(error), "test", path=path) from error


def _modes(job: Job, matching: Matching) -> ModeSet | None:
    """Return the modes that the job's test names, in its band."""
    from updyn.io import read_modes

    table = job.test
    if table.modes is None:
        return None
    path = _existing(job, table.modes, "test", "modes")
    with _at(job, "test", "modes"):
        modes = matched_modes(matching, read_modes(path))
        return modes if table.band is None else modes.select(band=table.band)


def _existing(job: Job, file: str, table: str, key: str = "file") -> Path:
    path = job.beside(file)
    if path.is_file():
        return path
    if path.is_dir():
        raise job.error(f"{table}.{key} = {file!r} is a folder ({path})", table, key)
    siblings = [p.name for p in path.parent.iterdir() if p.is_file()] if path.parent.is_dir() else []
    hint = suggest(path.name, siblings) if siblings else f"the folder {str(path.parent)!r} is empty or does not exist"
    raise job.error(f"{table}.{key} = {file!r}: no such file; {hint}", table, key)


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
    loaded = _with_all_masses(job, model)
    for number, table in enumerate(job.parameter):
        try:
            # Masses that a test adds are known: they are unknowns of who names them, not of "all" and "*".
            own = _fits(model, table.groups or (), []) and _fits(model, table.drives or (), GROUP_QUANTITIES)
            items = _choose(job, model if own else loaded, number)
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
    groups = list(loaded.groups)

    def place(entry: tuple[int, Parameter]) -> tuple[int, int]:
        number, p = entry
        if p.drives:  # after the others, as the job has them
            return len(groups), number
        return groups.index(p.group), _QUANTITY_ORDER.index(p.quantity)

    with _at(job, "parameter"):
        return ParameterSet(tuple(p for _, p in sorted(chosen.values(), key=place)))


def _with_calibration(job: Job, chosen: ParameterSet, data: Sequence[FRF]) -> ParameterSet:
    """Return the unknowns with the calibration factors that the job asks for."""
    items = list(chosen)
    first: dict[str, int] = {}
    for number, table in enumerate(job.calibration):
        try:
            found = calibration(
                data,
                responses=table.responses,
                references=table.references,
                prior_std=table.prior_std,
                bounds=table.bounds,
            )
        except InputError as error:
            raise job.error_about(str(error), "calibration", number) from error
        for p in found:
            if first.setdefault(p.name, number) != number:
                line = job.place("calibration", first[p.name])
                raise job.error(
                    f"{p.name} is already an unknown of the [[calibration]] on line {line}", "calibration", number
                )
        items += found
    whole = ParameterSet(tuple(items))
    with _at(job, "method", "name"):
        check_method(whole, job.method.name, method_class(job.method.name))
    return whole


def _fits(model: Model, patterns: Iterable[str], quantities: Iterable[str]) -> bool:
    """Whether each pattern fits a group of a model, or a quantity of one, ``"all"`` aside."""
    names = [f"{name}.{q}" for name in model.groups for q in quantities] or list(model.groups)
    return all(pattern == "all" or any(fnmatch.fnmatchcase(name, pattern) for name in names) for pattern in patterns)


def _sensor_mass(job: Job, number: int, group: str) -> float | None:
    """Return the nominal mass of a sensor's group; None of any other."""
    from updyn.elements.sensor_masses import sensor_group

    given = {
        mass
        for part in job.parts
        for key, mass in (part.test.sensor_masses or {}).items()
        if sensor_group(key) == group
    }
    if len(given) > 1:
        raise job.error(
            f"{group!r} weighs {' and '.join(f'{m:g}' for m in sorted(given))} kg in different tests; one unknown "
            "cannot be both",
            "parameter",
            number,
        )
    return given.pop() if given else None


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
    items = [replace(p, prior_std=table.prior_std, nominal=table.nominal, unit=table.unit) for p in items]
    if quantity != "mass" or table.nominal is not None:
        return items
    masses = [_sensor_mass(job, number, p.group) for p in items]
    return [p if m is None else replace(p, nominal=m, unit="kg") for p, m in zip(items, masses, strict=True)]
