"""The record of a run: one NetCDF-4 (HDF5) file, all of an `UpdateResult`, exactly.

xarray opens the root, which holds what one plots::

    frf, coherence *, variance *          (freq, response, reference): the measurement, as given
    parameter, group, quantity, start, lower, upper, prior_std *, value, std, at_bound     (parameter)
    link *                                (parameter): JSON text of drives, nominal, unit
    covariance                            (parameter, parameter_other)
    history_stage, history_number, history_cost, history_step, history_condition, history_accepted    (iteration)
    history_value                         (iteration, parameter)
    line                                  lines of the fit, in Hz
    residual_bands *                      (band, edge): Hz
    residual_misfit *, residual_alike *, residual_chi_square_p *, residual_whiteness_p *
                                          (fitted_response, fitted_reference, band): see updyn.updating.adequacy
    options, noise, correlation, identifiability, adequacy *, ...     JSON texts, see updyn.store.values

and the sub-groups ``start_model`` and ``updated_model`` are models as in `updyn.io.hdf5`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.errors import FormatError, InputError, suggest
from updyn.frf import FRF
from updyn.io.atomic import atomic_path, write_json
from updyn.io.hdf5 import check_kind, put_kind, put_model, take_model
from updyn.io.items import existing, library, placed
from updyn.store.netcdf import text_of, variable
from updyn.store.values import from_text, plain, to_text
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.adequacy import Adequacy, Misfit, Suspect
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import Drive, Parameter, ParameterSet
from updyn.updating.result import STATUSES, JointResult, UpdateResult

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "read_result",
    "result_to_json",
    "write_result",
    "write_result_json",
]

_TEXTS = ("status", "message", "remedy", "method", "title")
_JSON = (
    "options",
    "noise",
    "correlation",
    "timing_s",
    "versions",
    "fitted_responses",
    "validation_responses",
    "validation_band",
    "identifiability",
)
_RESIDUAL = ("bands", "misfit", "alike", "chi_square_p", "whiteness_p")
_STEP = {
    "stage": object,
    "number": np.int64,
    "cost": np.float64,
    "step": np.float64,
    "condition": np.float64,
}


def write_result(result: UpdateResult, path: str | Path) -> None:
    """Write all of a result to one file, replaced as a whole once it is complete.

    Parameters
    ----------
    result : UpdateResult
        The outcome of an update.
    path : path
        File to write, usually ``run.nc``.

    Raises
    ------
    InputError
        If a value, a deviation or a step names an unknown that is not among the parameters.

    Warns
    -----
    UpdynWarning
        If an option is an object that no file can keep; its text is kept.
    """
    import h5py

    data = _to_dataset(result)
    with atomic_path(path) as temporary:
        data.to_netcdf(temporary, engine="h5netcdf")
        with h5py.File(temporary, "r+") as file:
            put_kind(file, "result")
            stored: dict[int, Any] = {}
            put_model(file.create_group("start_model"), result.start, stored)
            put_model(file.create_group("updated_model"), result.model, stored)


def read_result(path: str | Path) -> UpdateResult:
    """Read a result as `write_result` writes it.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    UpdateResult
        Equal in every field to the one written.

    Raises
    ------
    FormatError
        If the file is not there, is damaged, or is not the record of a run (the right reader is
        named).
    """
    import h5py
    import xarray as xr

    path = existing(path)
    with library(path, "record of a run (NetCDF-4)"):
        with h5py.File(path, "r") as file:
            check_kind(file, path, "result")
            for name in ("start_model", "updated_model"):
                if name not in file:
                    raise FormatError(f"no group {name!r}; found: {', '.join(file)}", path)
            start, model = (
                take_model(file["start_model"], path),
                take_model(file["updated_model"], path),
            )
        with xr.open_dataset(path, engine="h5netcdf", decode_cf=False) as data:
            data.load()
    with placed(path):
        return _from_dataset(data, path, start=start, model=model, frf=FRF.from_xarray(data))


# -- to xarray ---------------------------------------------------------------------------------------------
def _to_dataset(result: UpdateResult) -> xr.Dataset:
    names = result.parameters.names
    data = result.frf.to_xarray()
    for name in _TEXTS:
        data.attrs[name] = getattr(result, name)
    for name in _JSON:
        value = getattr(result, name)
        data[name] = ((), to_text(asdict(value) if name == "identifiability" else value, name))
    if result.adequacy is not None:
        _put_adequacy(data, result.adequacy)
    data["line"] = ("line", result.lines, {"units": "Hz"})
    data.coords["parameter"] = ("parameter", _texts(names))
    for name in ("group", "quantity"):
        data[name] = ("parameter", _texts(getattr(p, name) for p in result.parameters))
    for name in ("start", "lower", "upper"):
        data[name] = ("parameter", getattr(result.parameters, name))
    priors = [p.prior_std for p in result.parameters]
    if any(p is not None for p in priors):
        data["prior_std"] = ("parameter", np.array([np.nan if p is None else p for p in priors]))
    if any(p.drives or p.nominal is not None for p in result.parameters):
        data["link"] = ("parameter", _texts(to_text(_link(p), p.name) for p in result.parameters))
    _put_table(data, "value", ("parameter",), [result.values], names)
    _put_table(data, "std", ("parameter",), [result.std], names)
    unknown = [name for name in result.at_bound if name not in names]
    if unknown:
        raise InputError(
            f"at_bound names {unknown[0]!r}, which is not an unknown; {suggest(unknown[0], names)}"
        )
    data["at_bound"] = ("parameter", _texts(result.at_bound.get(name, "") for name in names))
    data["covariance"] = (("parameter", "parameter_other"), result.covariance)
    for name, kind in _STEP.items():
        data[f"history_{name}"] = (
            "iteration",
            np.array([getattr(h, name) for h in result.history], dtype=kind),
        )
    data["history_accepted"] = (
        "iteration",
        np.array([h.accepted for h in result.history], dtype=np.int8),
    )
    _put_table(
        data, "history_value", ("iteration", "parameter"), [h.values for h in result.history], names
    )
    return data


def _put_adequacy(data: xr.Dataset, found: Adequacy) -> None:
    told = {k: v for k, v in asdict(found).items() if k not in _RESIDUAL}
    data["adequacy"] = ((), to_text(told, "adequacy"))
    data["residual_bands"] = (("band", "edge"), found.bands, {"units": "Hz"})
    for name in _RESIDUAL[1:]:
        data[f"residual_{name}"] = (
            ("fitted_response", "fitted_reference", "band"),
            getattr(found, name),
        )


def _link(p: Parameter) -> dict[str, Any]:
    return {
        "drives": [[d.group, d.quantity, d.power] for d in p.drives],
        "nominal": p.nominal,
        "unit": p.unit,
    }


def _texts(items: Iterable[str]) -> Any:
    return np.array(list(items), dtype=object)


def _put_table(
    data: xr.Dataset,
    name: str,
    dims: tuple[str, ...],
    rows: list[Mapping[str, float]],
    names: list[str],
) -> None:
    """Store rows by unknown. Where a row lacks one, NaN stands, and ``NAME_given`` tells it from a value of NaN."""
    table = np.full((len(rows), len(names)), np.nan)
    given = np.zeros(table.shape, dtype=np.int8)
    for i, row in enumerate(rows):
        for unknown, value in row.items():
            if unknown not in names:
                raise InputError(
                    f"{name} names {unknown!r}, which is not an unknown; {suggest(unknown, names)}"
                )
            table[i, names.index(unknown)] = value
            given[i, names.index(unknown)] = 1
    shape = tuple(len(rows) if dim == "iteration" else len(names) for dim in dims)
    data[name] = (dims, table.reshape(shape))
    if not given.all():
        data[f"{name}_given"] = (dims, given.reshape(shape))


# -- from xarray -------------------------------------------------------------------------------------------
def _from_dataset(data: xr.Dataset, path: Path, **parts: Any) -> UpdateResult:
    texts: dict[str, Any] = {name: text_of(data, name, path) for name in _TEXTS}
    if texts["status"] not in STATUSES:
        raise FormatError(f"status {texts['status']!r}; {suggest(texts['status'], STATUSES)}", path)
    mixed = {name: from_text(str(variable(data, name, path)[()]), name, path) for name in _JSON}
    ident = mixed.pop("identifiability")
    try:
        identifiability = Identifiability(**ident)
    except TypeError as error:
        raise FormatError(f"identifiability: {error}", path) from error
    parameters = _parameters(data, path)
    names = parameters.names
    covariance = variable(data, "covariance", path)
    if covariance.shape != (len(names), len(names)):
        raise FormatError(
            f"covariance: found shape {covariance.shape}, expected {(len(names), len(names))}", path
        )
    bounds = [str(b) for b in variable(data, "at_bound", path)]
    return UpdateResult(
        **texts,
        **mixed,
        **parts,
        lines=variable(data, "line", path),
        parameters=parameters,
        values=_table(data, "value", names, path)[0],
        std=_table(data, "std", names, path)[0],
        covariance=covariance,
        at_bound={name: bound for name, bound in zip(names, bounds, strict=True) if bound},
        identifiability=identifiability,
        history=_history(data, names, path),
        adequacy=_adequacy(data, path),
    )


def _adequacy(data: xr.Dataset, path: Path) -> Adequacy | None:
    if "adequacy" not in data.variables:  # nothing was tested, or the file is an old one
        return None
    given = from_text(str(data["adequacy"].values[()]), "adequacy", path)
    arrays = {name: variable(data, f"residual_{name}", path) for name in _RESIDUAL}
    try:
        worst = tuple(Misfit(**place) for place in given.pop("worst"))
        suspects = tuple(Suspect(**suspect) for suspect in given.pop("explained_by"))
        return Adequacy(**given, **arrays, worst=worst, explained_by=suspects)
    except (AttributeError, KeyError, TypeError) as error:
        raise FormatError(f"adequacy: not what a run records ({error})", path) from error


def _parameters(data: xr.Dataset, path: Path) -> ParameterSet:
    columns = [
        variable(data, name, path).tolist()
        for name in ("group", "quantity", "start", "lower", "upper")
    ]
    priors = (
        data["prior_std"].values.tolist()
        if "prior_std" in data.variables
        else [np.nan] * len(columns[0])
    )
    links: list[dict[str, Any]] = [{} for _ in priors]
    if "link" in data.variables:
        links = [_read_link(str(text), path) for text in data["link"].values]
    items = [
        Parameter(
            str(group),
            str(quantity),
            start,
            lower,
            upper,
            None if np.isnan(prior) else prior,
            **link,
        )
        for group, quantity, start, lower, upper, prior, link in zip(
            *columns, priors, links, strict=True
        )
    ]
    return ParameterSet(tuple(items))


def _read_link(text: str, path: Path) -> dict[str, Any]:
    link = from_text(text, "link", path)
    try:
        return {**link, "drives": tuple(Drive(*d) for d in link["drives"])}
    except (KeyError, TypeError) as error:
        raise FormatError(
            f"link: {text!r} is not what an unknown acts on ({error})", path
        ) from error


def _history(data: xr.Dataset, names: list[str], path: Path) -> tuple[Iteration, ...]:
    columns = {
        name: variable(data, f"history_{name}", path).tolist() for name in (*_STEP, "accepted")
    }
    values = _table(data, "history_value", names, path)
    return tuple(
        Iteration(str(stage), int(number), cost, step, condition, bool(accepted), row)
        for stage, number, cost, step, condition, accepted, row in zip(
            *columns.values(), values, strict=True
        )
    )


def _table(data: xr.Dataset, name: str, names: list[str], path: Path) -> list[dict[str, float]]:
    table = variable(data, name, path).reshape(-1, len(names))
    mask = f"{name}_given"
    given = (
        data[mask].values.reshape(table.shape)
        if mask in data.variables
        else np.ones(table.shape, dtype=np.int8)
    )
    return [
        {
            unknown: float(value)
            for unknown, value, there in zip(names, row, kept, strict=True)
            if there
        }
        for row, kept in zip(table, given, strict=True)
    ]


def result_to_json(result: UpdateResult | JointResult) -> dict[str, Any]:
    """Return the outcome as a dict that `json.dumps` writes without inf or nan.

    Parameters
    ----------
    result : UpdateResult or JointResult
        The outcome. Of several tests, ``correlation`` and ``noise`` are those of the first.

    Returns
    -------
    dict
        ``status``, ``message``, ``remedy``, ``title``, ``method``, ``options``; ``parameters``, one
        dict an unknown in order, with ``std`` None and ``identifiable`` False where the data leave
        it open, ``at_bound`` True or False and ``bound`` ``"lower"``, ``"upper"`` or None,
        ``nominal`` and ``unit`` of what a factor of 1 stands for, ``drives`` of a linked unknown;
        ``identifiability``; ``correlation`` with ``before``, ``after`` and ``validation`` (empty
        where there is none); ``noise``; ``iterations`` (accepted steps) and ``history``;
        ``timing_s`` in s; ``versions``; ``adequacy``, None where it was not tested: ``outcome``,
        ``verdict``, ``absolute``, ``chi_square``, ``p_value``, ``level``, ``bands`` in Hz,
        ``misfit`` over noise by response, reference and band, the ``worst`` places and
        ``explained_by``. Of several tests also ``tests``: ``correlation``, ``noise`` and
        ``adequacy`` by name.
    """
    if isinstance(result, JointResult):
        own = {name: result_to_json(one) for name, one in result.results.items()}
        tests = {
            name: {key: one[key] for key in ("correlation", "noise", "adequacy")}
            for name, one in own.items()
        }
        return {**next(iter(own.values())), "title": result.title, "tests": tests}
    ident = result.identifiability
    return {
        "status": result.status,
        "message": result.message,
        "remedy": result.remedy,
        "title": result.title,
        "method": result.method,
        "options": plain(result.options),
        "parameters": [_parameter_json(result, name) for name in result.parameters.names],
        "identifiability": plain(
            {
                "rank": ident.rank,
                "n_parameters": ident.n_parameters,
                "condition": ident.condition,
                "null_directions": ident.null_directions,
                "determined_directions": ident.determined_directions,
                "collinearity": ident.collinearity,
                "singular_values": ident.singular_values,
                "advice": ident.advice,
            }
        ),
        "correlation": {
            when: plain(result.correlation.get(when, {}))
            for when in ("before", "after", "validation")
        },
        "noise": plain(result.noise),
        "iterations": result.iterations,
        "history": [
            plain(
                {
                    key: getattr(h, key)
                    for key in ("stage", "number", "cost", "step", "condition", "accepted")
                }
            )
            for h in result.history
        ],
        "timing_s": plain(result.timing_s),
        "versions": plain(result.versions),
        "adequacy": _adequacy_json(result.adequacy),
    }


def _adequacy_json(found: Adequacy | None) -> dict[str, Any] | None:
    if found is None:
        return None
    keys = ("outcome", "verdict", "absolute", "chi_square", "p_value", "level", "bands", "misfit")
    places = {
        "worst": [asdict(p) for p in found.worst],
        "explained_by": [asdict(s) for s in found.explained_by],
    }
    out: dict[str, Any] = plain({**{key: getattr(found, key) for key in keys}, **places})
    return out


def _parameter_json(result: UpdateResult, name: str) -> dict[str, Any]:
    unknown = next(p for p in result.parameters if p.name == name)
    std = result.std.get(name, math.nan)
    numbers = {
        "start": unknown.start,
        "value": result.values.get(name, math.nan),
        "std": std,
        "lower": unknown.lower,
        "upper": unknown.upper,
    }
    return {
        "name": name,
        "group": unknown.group,
        "quantity": unknown.quantity,
        **plain(numbers),
        "nominal": unknown.nominal,
        "unit": unknown.unit,
        "drives": [
            {"group": d.group, "quantity": d.quantity, "power": d.power} for d in unknown.drives
        ],
        "at_bound": name in result.at_bound,
        "bound": result.at_bound.get(name),
        "identifiable": bool(math.isfinite(std)),
    }


def write_result_json(result: UpdateResult | JointResult, path: str | Path) -> None:
    """Write `result_to_json` to a file, replaced as a whole once it is complete.

    Parameters
    ----------
    result : UpdateResult or JointResult
        The outcome.
    path : path
        File to write, usually ``result.json``.
    """
    write_json(result_to_json(result), path)
