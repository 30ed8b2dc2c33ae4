"""The record of a run: one NetCDF-4 (HDF5) file with the exact content of an `UpdateResult`.

xarray opens the root, which contains the data of plots::

    frf, coherence *, variance *          (freq, response, reference): the measurement, as given
    measured_frequency *, ...             instead, for measured modes: see
                                          updyn.store.measured_modes
    parameter, group, quantity, start, lower, upper, prior_std *, value, std, at_bound
                                          (parameter)
    link *                                (parameter): JSON text of drives, nominal, unit
    covariance                            (parameter, parameter_other)
    history_stage, history_number, history_cost, history_step, history_condition, history_accepted
                                          (iteration)
    history_value                         (iteration, parameter)
    line                                  frequency lines of the fit, in Hz
    residual_bands *                      (band, edge): Hz
    residual_misfit *, residual_correlation_length *,
    residual_chi_square_p *, residual_whiteness_p *
                                          (fitted_response, fitted_reference, band):
                                          see updyn.updating.judge.adequacy
    modes_test *, modes_start *, modes_updated *
                                          frequencies in Hz, (modes_test) and so on
    modes_test_loss_factor *, ...         the same, likewise of the other two sets
    modes_test_shapes *, ...              (modes_dof, modes_test) and so on; complex ones have a
                                          last axis ``part``, real and imaginary
    modes_cross_orthogonality *, modes_own_orthogonality *
                                          (modes_updated, modes_test or modes_updated_other)
    options, noise, correlation, identifiability, adequacy *, modes *, ...
                                          JSON texts, see updyn.store.values

and the sub-groups ``start_model`` and ``updated_model`` are models as in `updyn.io.hdf5`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from updyn.arrays import NumberArray
from updyn.dofs import DofSet
from updyn.dynamics.modes import Modes
from updyn.errors import FormatError, InputError, suggest
from updyn.frf import FRF
from updyn.io.atomic import write_json
from updyn.io.hdf5 import put_model, take_model
from updyn.io.items import guard_reader, locate_errors
from updyn.modal import ModeSet
from updyn.remedy import Remedy
from updyn.store.measured_modes import put_mode_set, take_mode_set
from updyn.store.netcdf import (
    Array,
    FieldFormat,
    Mixed,
    Text,
    put_fields,
    read_dataset,
    take_fields,
    texts,
    variable,
    write_dataset,
)
from updyn.store.values import from_text, plain, plain_fields, plain_records, to_text
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.adequacy import Adequacy, Misfit, NoisySensor, Suspect
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts, Pair
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.judge.trust import PARTS, Claim, Trust
from updyn.updating.problem.parameters import Drive, Parameter, ParameterSet
from updyn.updating.result import STATUSES, JointResult, UpdateResult

if TYPE_CHECKING:
    import h5py
    import xarray as xr

__all__ = ["read_result", "result_to_json", "write_result", "write_result_json"]

_T = TypeVar("_T")


def write_result(result: UpdateResult, path: str | Path) -> None:
    """Write the record of an update.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    result : UpdateResult
        The outcome of an update.
    path : path
        File to write, usually ``run.nc``.

    Raises
    ------
    InputError
        If a value, a deviation or a step refers to an unknown that is not among the parameters.

    Warns
    -----
    UpdynWarning
        If an option is an object that cannot be stored; its text is stored instead.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.write_result(result, "run.nc")
    >>> updyn.read_result("run.nc").values == result.values
    True
    """

    def put_models(file: h5py.File) -> None:
        stored: dict[int, Any] = {}
        put_model(file.create_group("start_model"), result.start, stored)
        put_model(file.create_group("updated_model"), result.model, stored)

    data = (
        put_mode_set(result.data) if isinstance(result.data, ModeSet) else result.data.to_xarray()
    )
    put_fields(data, result, _RESULT)
    write_dataset(data, path, "result", put_models)


def read_result(path: str | Path) -> UpdateResult:
    """Read the record of an update written by `write_result`.

    Parameters
    ----------
    path : path
        The file, usually ``run.nc``.

    Returns
    -------
    UpdateResult
        Equal in every field to the written one, with its models.

    Raises
    ------
    FormatError
        If the file does not exist, is damaged, or is not the record of an update (the message gives
        the right reader).

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.write_result(result, "run.nc")
    >>> updyn.read_result("run.nc").status
    'converged'
    """
    path = Path(path)

    groups = {"start": "start_model", "model": "updated_model"}
    data, found = read_dataset(path, "result", "record of a run", tuple(groups.values()))
    models: dict[str, Any] = {f: take_model(found[name], path) for f, name in groups.items()}
    with guard_reader(path, "result"), locate_errors(path):
        fields = take_fields(data, _RESULT, path)
        measured = take_mode_set(data, path) or FRF.from_xarray(data)
        return UpdateResult(data=measured, **models, **fields)


# -- fields with a special format ---------------------------------------------------------------
class _Parameters:
    """The unknowns: columns over ``parameter``, with prior and link if any unknown has one."""

    def store(self, data: xr.Dataset, name: str, value: ParameterSet) -> None:
        data.coords["parameter"] = ("parameter", texts(value.names))
        groups, quantities, links = [], [], []
        priors = np.full(len(value), np.nan)
        is_linked = False
        for i, p in enumerate(value):
            groups.append(p.group)
            quantities.append(p.quantity)
            links.append(to_text(self._link(p), p.name))
            is_linked |= bool(p.drives) or p.nominal is not None or p.of_element
            if p.prior_std is not None:
                priors[i] = p.prior_std
        data["group"] = ("parameter", texts(groups))
        data["quantity"] = ("parameter", texts(quantities))
        for column in ("start", "lower", "upper"):
            data[column] = ("parameter", getattr(value, column))
        if not np.isnan(priors).all():
            data["prior_std"] = ("parameter", priors)
        if is_linked:
            data["link"] = ("parameter", texts(links))

    def load(self, data: xr.Dataset, name: str, path: Path) -> ParameterSet:
        columns = ("group", "quantity", "start", "lower", "upper")
        rows = zip(*(variable(data, column, path).tolist() for column in columns), strict=True)
        found = []
        for i, (group, quantity, start, lower, upper) in enumerate(rows):
            prior = None
            if "prior_std" in data.variables and not np.isnan(data["prior_std"].values[i]):
                prior = float(data["prior_std"].values[i])
            link = {}
            if "link" in data.variables:
                link = self._take_link(str(data["link"].values[i]), path)
            found.append(Parameter(str(group), str(quantity), start, lower, upper, prior, **link))
        return ParameterSet(tuple(found))

    @staticmethod
    def _link(unknown: Parameter) -> dict[str, object]:
        return {
            "drives": [
                [d.group, d.quantity, d.power, *([True] if d.of_element else [])]
                for d in unknown.drives
            ],
            "nominal": unknown.nominal,
            "unit": unknown.unit,
            **_mark_element(unknown),
        }

    @staticmethod
    def _take_link(text: str, path: Path) -> dict[str, Any]:
        link = from_text(text, "link", path)
        try:
            return {**link, "drives": tuple(Drive(*d) for d in link["drives"])}
        except (KeyError, TypeError) as error:
            raise FormatError(
                f"link: {text!r} is not a valid link of an unknown ({error})", path
            ) from error


class _ByUnknown:
    """One number for each unknown, by name.

    A missing number is stored as NaN, and ``NAME_given`` distinguishes it from a value of NaN.
    """

    def __init__(self, variable: str) -> None:
        self._variable = variable

    def store(self, data: xr.Dataset, name: str, value: Mapping[str, float]) -> None:
        _put_rows(data, self._variable, [value], ("parameter",))

    def load(self, data: xr.Dataset, name: str, path: Path) -> dict[str, float]:
        return _take_rows(data, self._variable, path)[0]


class _AtBound:
    """The active bound of each unknown, or an empty text."""

    def store(self, data: xr.Dataset, name: str, value: Mapping[str, str]) -> None:
        bounds = dict.fromkeys(data["parameter"].values.tolist(), "")
        for unknown, bound in value.items():
            if unknown not in bounds:
                raise InputError(
                    f"{name} contains {unknown!r}, which is not an unknown;"
                    f" {suggest(unknown, bounds)}"
                )
            bounds[unknown] = bound
        data[name] = ("parameter", texts(bounds.values()))

    def load(self, data: xr.Dataset, name: str, path: Path) -> dict[str, str]:
        names = map(str, variable(data, "parameter", path))
        bounds = map(str, variable(data, name, path))
        return {unknown: bound for unknown, bound in zip(names, bounds, strict=True) if bound}


class _History:
    """The steps: columns over ``iteration``, and the values of the unknowns after each."""

    _COLUMNS: ClassVar[dict[str, type]] = {
        "stage": object,
        "number": np.int64,
        "cost": np.float64,
        "step": np.float64,
        "condition": np.float64,
        "accepted": np.int8,
    }

    def store(self, data: xr.Dataset, name: str, value: tuple[Iteration, ...]) -> None:
        for column, kind in self._COLUMNS.items():
            entries: Any = np.array([getattr(step, column) for step in value], dtype=kind)
            data[f"history_{column}"] = ("iteration", entries)
        rows = [step.values for step in value]
        _put_rows(data, "history_value", rows, ("iteration", "parameter"))

    def load(self, data: xr.Dataset, name: str, path: Path) -> tuple[Iteration, ...]:
        columns = [variable(data, f"history_{c}", path).tolist() for c in self._COLUMNS]
        values = _take_rows(data, "history_value", path)
        found = []
        for *entries, row in zip(*columns, values, strict=True):
            stage, number, cost, step, condition, accepted = entries
            found.append(
                Iteration(str(stage), int(number), cost, step, condition, bool(accepted), row)
            )
        return tuple(found)


class _Adequacy:
    """The test of the residual: arrays as variables ``residual_NAME``, the rest as JSON text."""

    _PLACE = ("fitted_response", "fitted_reference", "band")
    _ARRAYS: Mapping[str, FieldFormat] = {
        "bands": Array("band", "edge", variable="residual_bands", unit="Hz"),
        "misfit": Array(*_PLACE, variable="residual_misfit"),
        "correlation_length": Array(*_PLACE, variable="residual_correlation_length"),
        "chi_square_p": Array(*_PLACE, variable="residual_chi_square_p"),
        "whiteness_p": Array(*_PLACE, variable="residual_whiteness_p"),
    }

    def store(self, data: xr.Dataset, name: str, value: Adequacy | None) -> None:
        if value is None:
            return
        rest = asdict(value)
        for key in self._ARRAYS:
            del rest[key]
        data[name] = ((), to_text(rest, name))
        put_fields(data, value, self._ARRAYS)

    def load(self, data: xr.Dataset, name: str, path: Path) -> Adequacy | None:
        if name not in data.variables:  # not tested, or an old file
            return None
        rest = Mixed().load(data, name, path)
        arrays = take_fields(data, self._ARRAYS, path)
        try:
            worst = _records(Misfit, rest.pop("worst"))
            suspects = _records(Suspect, rest.pop("explained_by"))
            noisy = _records(NoisySensor, rest.pop("noisy", []))  # missing in old files
            rest["lone"] = tuple(rest.get("lone", ()))
            return Adequacy(**rest, **arrays, worst=worst, explained_by=suspects, noisy=noisy)
        except (AttributeError, KeyError, TypeError) as error:
            raise FormatError(f"{name}: not a valid record of a run ({error})", path) from error


class _Steps:
    """The advised steps as JSON text, and as the attribute ``remedy``, all that old files have."""

    def store(self, data: xr.Dataset, name: str, value: tuple[Remedy, ...]) -> None:
        Text().store(data, "remedy", "\n".join(map(str, value)))
        _Records(Remedy).store(data, name, value)

    def load(self, data: xr.Dataset, name: str, path: Path) -> tuple[object, ...]:
        if name in data.variables:
            return _Records(Remedy).load(data, name, path)
        return tuple(map(Remedy, Text().load(data, "remedy", path).splitlines()))


class _Records:
    """Records of a dataclass, as JSON text; absent if there are no records, and in old files.

    `kind` makes a record from its fields.
    """

    def __init__(self, kind: Callable[..., object]) -> None:
        self._kind = kind

    def store(self, data: xr.Dataset, name: str, value: tuple[Any, ...]) -> None:
        if value:
            data[name] = ((), to_text([asdict(one) for one in value], name))

    def load(self, data: xr.Dataset, name: str, path: Path) -> tuple[object, ...]:
        if name not in data.variables:
            return ()
        try:
            return _records(self._kind, Mixed().load(data, name, path))
        except (KeyError, TypeError) as error:
            raise FormatError(f"{name}: not a valid record of a run ({error})", path) from error


def _make_finding(**row: Any) -> Finding:
    """Return a finding from its fields; old records have the advice as text only."""
    step = Remedy(row.pop("remedy")) if "remedy" in row else Remedy(**row.pop("step"))
    return Finding(**row, step=step)


class _Trust:
    """The parts of the verdict, as JSON text; absent in old records."""

    def store(self, data: xr.Dataset, name: str, value: Trust | None) -> None:
        if value is not None:
            data[name] = ((), to_text(_trust_json(value), name))

    def load(self, data: xr.Dataset, name: str, path: Path) -> Trust | None:
        if name not in data.variables:
            return None
        found = Mixed().load(data, name, path)
        try:
            # Old records do not compare modes.
            known = [part for part in PARTS if part in found or part != "resembles"]
            return Trust(**{part: _claim(found[part]) for part in known})
        except (KeyError, TypeError) as error:
            raise FormatError(f"{name}: not a valid record of a run ({error})", path) from error


def _trust_json(trust: Trust) -> dict[str, dict[str, object]]:
    return {part: {**asdict(claim), "why": claim.why} for part, claim in trust.items()}


def _claim(found: Mapping[str, Any]) -> Claim:
    """Return a part of a verdict; old records have its reason as one text only."""
    statement = found.get("statement", found["why"])
    return Claim(found["holds"], statement, found.get("asked", True), found.get("further", ""))


class _Counterparts:
    """The measured modes with a counterpart in the model before the search, as JSON text."""

    def store(self, data: xr.Dataset, name: str, value: Counterparts | None) -> None:
        if value is not None:
            data[name] = ((), to_text(asdict(value), name))

    def load(self, data: xr.Dataset, name: str, path: Path) -> Counterparts | None:
        if name not in data.variables:  # an old record
            return None
        found = Mixed().load(data, name, path)
        try:
            pairs = _records(Pair, found.pop("pairs"))
            return Counterparts(**{**found, "pairs": pairs, "doubtful": tuple(found["doubtful"])})
        except (AttributeError, KeyError, TypeError) as error:
            raise FormatError(f"{name}: not a valid record of a run ({error})", path) from error


class _Modes:
    """The modal table: frequencies, loss factors and shapes (real and imaginary part)."""

    _SETS = ("test", "start", "updated")
    _TABLES: ClassVar[dict[str, tuple[str, str]]] = {
        "cross_orthogonality": ("modes_updated", "modes_test"),
        "own_orthogonality": ("modes_updated", "modes_updated_other"),
    }

    def store(self, data: xr.Dataset, name: str, value: ModalTable | None) -> None:
        if value is None:
            return
        data[name] = ((), to_text(list(value.notes), name))
        if value.test is not None:
            data.coords["modes_dof"] = ("modes_dof", texts(value.test.dofs.labels))
        for of in self._SETS:
            found = getattr(value, of)
            if found is not None:
                data[f"modes_{of}"] = (f"modes_{of}", found.frequency, {"units": "Hz"})
                data[f"modes_{of}_loss_factor"] = (f"modes_{of}", found.loss_factor)
                dims = ("modes_dof", f"modes_{of}")
                data[f"modes_{of}_shapes"] = _split_parts(dims, found.shapes)
        for table, axes in self._TABLES.items():
            found = getattr(value, table)
            if found is not None:
                data[f"modes_{table}"] = _split_parts(axes, found)

    def load(self, data: xr.Dataset, name: str, path: Path) -> ModalTable | None:
        if name not in data.variables:  # not compared, or an old file
            return None
        fields: dict[str, Any] = {of: self._load_modes(data, of, path) for of in self._SETS}
        for table in self._TABLES:
            if f"modes_{table}" in data.variables:
                fields[table] = _join_parts(variable(data, f"modes_{table}", path))
        notes = tuple(Mixed().load(data, name, path))
        try:
            return ModalTable(**fields, notes=notes)
        except InputError as error:
            raise FormatError(f"{name}: not a valid record of a run ({error})", path) from error

    def _load_modes(self, data: xr.Dataset, of: str, path: Path) -> Modes | None:
        if f"modes_{of}" not in data.variables:
            return None
        columns = (
            variable(data, f"modes_{of}", path),
            variable(data, f"modes_{of}_loss_factor", path),
        )
        shapes = _join_parts(variable(data, f"modes_{of}_shapes", path))
        return Modes(*columns, shapes, DofSet(map(str, variable(data, "modes_dof", path))))


def _split_parts(dims: tuple[str, str], values: NumberArray) -> tuple[tuple[str, ...], NumberArray]:
    """Return a table as a variable; complex numbers get an additional axis for their parts."""
    if not np.iscomplexobj(values):
        return dims, values
    return (*dims, "part"), np.stack([values.real, values.imag], axis=-1)


def _join_parts(stored: NumberArray) -> NumberArray:
    """Return the table that was split by `_split_parts`."""
    if stored.ndim == 2:
        return stored
    return stored[..., 0] + 1j * stored[..., 1]


def _records(kind: Callable[..., _T], rows: Iterable[Mapping[str, Any]]) -> tuple[_T, ...]:
    return tuple(kind(**row) for row in rows)


#: Fields of an `UpdateResult` except its models and its FRF, in the order of the file.
_RESULT: dict[str, FieldFormat] = {
    "status": Text(STATUSES),
    "message": Text(),
    "steps": _Steps(),
    "method": Text(),
    "title": Text(),
    "options": Mixed(),
    "noise": Mixed(),
    "correlation": Mixed(),
    "timing_s": Mixed(),
    "versions": Mixed(),
    "fitted_responses": Mixed(),
    "validation_responses": Mixed(),
    "validation_band": Mixed(),
    "identifiability": Mixed(Identifiability),
    "adequacy": _Adequacy(),
    "alternatives": _Records(Alternative),
    "trust": _Trust(),
    "findings": _Records(_make_finding),
    "modes": _Modes(),
    "counterparts": _Counterparts(),
    "lines": Array("line", variable="line", unit="Hz"),
    "parameters": _Parameters(),
    "values": _ByUnknown("value"),
    "std": _ByUnknown("std"),
    "at_bound": _AtBound(),
    "covariance": Array("parameter", "parameter_other"),
    "history": _History(),
}


def _put_rows(
    data: xr.Dataset, name: str, rows: list[Mapping[str, float]], dims: tuple[str, ...]
) -> None:
    names = data["parameter"].values.tolist()
    table = np.full((len(rows), len(names)), np.nan)
    given = np.zeros(table.shape, dtype=np.int8)
    for i, row in enumerate(rows):
        for unknown, value in row.items():
            if unknown not in names:
                raise InputError(
                    f"{name} contains {unknown!r}, which is not an unknown;"
                    f" {suggest(unknown, names)}"
                )
            table[i, names.index(unknown)] = value
            given[i, names.index(unknown)] = 1
    shape = table.shape[2 - len(dims) :]
    data[name] = (dims, table.reshape(shape))
    if not given.all():
        data[f"{name}_given"] = (dims, given.reshape(shape))


def _take_rows(data: xr.Dataset, name: str, path: Path) -> list[dict[str, float]]:
    names = texts(map(str, variable(data, "parameter", path)))
    table = variable(data, name, path).reshape(-1, len(names))
    given = np.ones(table.shape, dtype=np.bool_)
    if f"{name}_given" in data.variables:
        given = data[f"{name}_given"].values.reshape(table.shape).astype(np.bool_)
    rows = []
    for numbers, is_given in zip(table, given, strict=True):
        rows.append(dict(zip(names[is_given], numbers[is_given].tolist(), strict=True)))
    return rows


# -- JSON ---------------------------------------------------------------------------------------
def result_to_json(result: UpdateResult | JointResult) -> dict[str, object]:
    """Return the outcome as a dict (docs/job.md) that `json.dumps` writes without inf or nan.

    For several tests, ``correlation`` and ``noise`` are those of the first, and ``tests`` has those
    of each. Entries that old records lack, such as ``trust``, are None, and so is the ``std`` of an
    unknown that the data do not determine.
    """
    if isinstance(result, JointResult):
        first: dict[str, Any] = {}
        tests = {}
        for name, one in result.results.items():
            record = result_to_json(one)
            first = first or record
            tests[name] = {key: record[key] for key in _OF_A_TEST}
        return {**first, "title": result.title, "tests": tests}
    correlation = {
        when: plain(result.correlation.get(when, {})) for when in ("before", "after", "validation")
    }
    return {
        **plain_fields(result, "status", "message", "remedy"),
        "steps": plain_records(result.steps),
        **plain_fields(result, "title", "method", "options"),
        "parameters": [_parameter_json(result, unknown) for unknown in result.parameters],
        "identifiability": plain_fields(result.identifiability, *_IDENTIFIABILITY),
        "correlation": correlation,
        **plain_fields(result, "noise", "iterations"),
        "history": [plain_fields(step, *_STEP) for step in result.history],
        **plain_fields(result, "timing_s", "versions"),
        "adequacy": _adequacy_json(result.adequacy),
        "trust": None if result.trust is None else _trust_json(result.trust),
        "findings": [{**plain(asdict(one)), "remedy": one.remedy} for one in result.findings],
        "alternatives": plain_records(result.alternatives),
        "modes": _modes_json(result.modes),
        "counterparts": None if result.counterparts is None else plain(asdict(result.counterparts)),
    }


def _modes_json(found: ModalTable | None) -> dict[str, Any] | None:
    if found is None:
        return None
    mac: dict[str, object] = {}
    subspaces: dict[str, object] = {}
    by_dof: dict[str, dict[str, object]] = {"comac": {}, "ecomac": {}}
    auto_mac = None
    for name, one in found.correlations.items():
        mac[name] = one.mac
        subspaces[name] = plain_records(one.subspaces)
        auto_mac = one.auto_mac
        labels = one.dofs.labels
        for kind, values in (("comac", one.comac()), ("ecomac", one.ecomac())):
            by_dof[kind][name] = dict(zip(labels, values.tolist(), strict=True))
    record = {"known": found.known, "notes": found.notes, "rows": list(map(asdict, found.rows))}
    record |= {
        "mac": mac,
        "subspaces": subspaces,
        "auto_mac": auto_mac,
        **by_dof,
        "figures": found.figures(),
    }
    return plain(record)  # type: ignore[no-any-return]


def _adequacy_json(found: Adequacy | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        **plain_fields(found, *_ADEQUACY),
        "worst": plain_records(found.worst),
        "explained_by": plain_records(found.explained_by),
        "noisy": plain_records(found.noisy),
        "lone": list(found.lone),
    }


#: Items that each test has separately.
_OF_A_TEST = ("correlation", "noise", "adequacy", "modes", "counterparts")
_IDENTIFIABILITY = (
    "rank",
    "n_parameters",
    "condition",
    "null_directions",
    "determined_directions",
    "collinearity",
    "singular_values",
    "advice",
)
_STEP = ("stage", "number", "cost", "step", "condition", "accepted")
_ADEQUACY = (
    "outcome",
    "verdict",
    "absolute",
    "chi_square",
    "p_value",
    "level",
    "bands",
    "misfit",
)


def _parameter_json(result: UpdateResult, unknown: Parameter) -> dict[str, Any]:
    name = unknown.name
    std = result.std.get(name, math.nan)
    return {
        **plain_fields(unknown, "name", "group", "quantity", "start"),
        "value": plain(result.values.get(name, math.nan)),
        "std": plain(std),
        **plain_fields(unknown, "lower", "upper", "nominal", "unit"),
        **_mark_element(unknown),
        "drives": [
            {**plain_fields(d, "group", "quantity", "power"), **_mark_element(d)}
            for d in unknown.drives
        ],
        "at_bound": name in result.at_bound,
        "bound": result.at_bound.get(name),
        "identifiable": bool(math.isfinite(std)),
    }


def _mark_element(given: Parameter | Drive) -> dict[str, bool]:
    """Return the mark of a parameter of a nonlinear element; none for others."""
    return {"of_element": True} if given.of_element else {}


def write_result_json(result: UpdateResult | JointResult, path: str | Path) -> None:
    """Write `result_to_json` to a file, which is replaced only once the new one is complete."""
    write_json(result_to_json(result), path)
