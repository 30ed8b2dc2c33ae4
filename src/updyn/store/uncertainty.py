"""Draws and profiles as netCDF-4 (HDF5), exactly; their update is in a separate file.

xarray opens the file. It contains for draws::

    draws                                      (chain, draw, parameter), in the unit of each unknown
    estimate, std, lower, upper, is_factor     (parameter)
    diagnostic_NAME                            (parameter): r_hat, ess_bulk, ...
    attributes kind, message, converged; failed, options: JSON texts, see updyn.store.values

and for profiles, with a row for each profiled unknown, padded with nan::

    value, drop                                (profile, point)
    others                                     (profile, point, parameter)
    estimate                                   (profile)
    attributes kind, level, threshold; intervals, ends, missing, better,
    reduction, model_error: JSON texts
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from updyn.errors import OptionError
from updyn.io.items import guard_reader
from updyn.store.netcdf import (
    Array,
    Arrays,
    FieldFormat,
    Mixed,
    Number,
    Text,
    Texts,
    put_fields,
    read_dataset,
    take_fields,
    texts,
    variable,
    write_dataset,
)
from updyn.store.values import to_text
from updyn.uncertainty.draws import KINDS, Draws
from updyn.uncertainty.profile import Interval, Profile, Profiles
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["read_uncertainty", "write_uncertainty"]

_DRAWS: dict[str, FieldFormat] = {
    "names": Texts("parameter"),
    "chains": Array("chain", "draw", "parameter", variable="draws"),
    "estimate": Array("parameter"),
    "std": Array("parameter"),
    "lower": Array("parameter"),
    "upper": Array("parameter"),
    "is_factor": Array("parameter", is_flag=True),
    "diagnostics": Arrays("diagnostic_", "parameter"),
    "kind": Text(KINDS),
    "message": Text(),
    "converged": Number(bool),
    "failed": Mixed(is_attribute=True),
    "options": Mixed(is_attribute=True),
}
_PROFILES: dict[str, FieldFormat] = {
    "level": Number(float),
    "threshold": Number(float),
    "better": Mixed(is_attribute=True),
    "reduction": Mixed(is_attribute=True, absent={}),  # older files have none
    "model_error": Mixed(is_attribute=True, absent=0.0),  # older files have none
}


def write_uncertainty(found: Draws | Profiles, path: str | Path) -> None:
    """Write draws or profiles.

    An existing file is replaced only once the new one is complete.

    Parameters
    ----------
    found : Draws or Profiles
        From `updyn.bootstrap`, `updyn.sample` or `updyn.profile`.
    path : path
        File to write, usually ``uncertainty.nc``.

    Raises
    ------
    OptionError
        If it is neither.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.write_uncertainty(updyn.bootstrap(result, n=20), "uncertainty.nc")
    >>> updyn.read_uncertainty("uncertainty.nc").values.shape
    (20, 12)
    """
    if isinstance(found, Draws):
        data = _store_draws(found)
    elif isinstance(found, Profiles):
        data = _store_profiles(found)
    else:
        raise OptionError(f"expected draws or profiles, found {type(found).__name__}")
    write_dataset(data, path, "uncertainty")


def read_uncertainty(
    path: str | Path, result: UpdateResult | JointResult | None = None
) -> Draws | Profiles:
    """Read draws or profiles written by `write_uncertainty`.

    Parameters
    ----------
    path : path
        The file, usually ``uncertainty.nc``.
    result : UpdateResult or JointResult, optional
        The update of the draws (`read_result`), which `updyn.predict` needs.

    Returns
    -------
    Draws or Profiles
        Equal to the written ones, except for the update.

    Raises
    ------
    FormatError
        If the file does not exist, is damaged, or is of another kind (the message gives the right
        reader).
    OptionError
        If the draws belong to another update.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.write_uncertainty(updyn.profile(result, ["part3.stiffness"]), "uncertainty.nc")
    >>> updyn.read_uncertainty("uncertainty.nc", result)
    Profiles(1 unknowns, 95 %)
    """
    path = Path(path)
    data, _ = read_dataset(path, "uncertainty", "draws or profiles")
    with guard_reader(path, "uncertainty"):
        if Text(("profile", *KINDS)).load(data, "kind", path) == "profile":
            return _load_profiles(data, path)
        draws = Draws(**take_fields(data, _DRAWS, path))
    if result is None:
        return draws
    return draws.of(result)


def _store_draws(found: Draws) -> xr.Dataset:
    import xarray as xr

    data = xr.Dataset()
    put_fields(data, found, _DRAWS)
    return data


def _store_profiles(found: Profiles) -> xr.Dataset:
    import xarray as xr

    listed = list(found.values())
    points = max((len(p.values) for p in listed), default=0)
    n_parameters = 0
    if listed:
        n_parameters = listed[0].others.shape[1]
    values = np.full((len(listed), points), np.nan)
    drop = values.copy()
    others = np.full((len(listed), points, n_parameters), np.nan)
    estimates, ranges, ends = [], [], []
    for row, one in enumerate(listed):
        n = len(one.values)
        values[row, :n] = one.values
        drop[row, :n] = one.drop
        others[row, :n] = one.others
        estimates.append(one.estimate)
        ranges.append([[h.lower, h.best, h.upper, h.drop] for h in one.intervals])
        ends.append([one.lower_end, one.upper_end])
    data = xr.Dataset(coords={"profile": ("profile", texts(found))})
    data["value"] = (("profile", "point"), values)
    data["drop"] = (("profile", "point"), drop)
    data["others"] = (("profile", "point", "parameter"), others)
    data["estimate"] = ("profile", np.array(estimates))
    data.attrs["kind"] = "profile"
    data.attrs["intervals"] = to_text(ranges, "intervals")
    data.attrs["ends"] = to_text(ends, "ends")
    data.attrs["missing"] = to_text(list(found.missing), "missing")
    put_fields(data, found, _PROFILES)
    return data


def _load_profiles(data: xr.Dataset, path: Path) -> Profiles:
    values = variable(data, "value", path)
    drop = variable(data, "drop", path)
    others = variable(data, "others", path)
    rows = zip(
        variable(data, "profile", path),
        variable(data, "estimate", path),
        Mixed(is_attribute=True).load(data, "intervals", path),
        Mixed(is_attribute=True).load(data, "ends", path),
        strict=True,
    )
    found = []
    for i, (name, estimate, ranges, (lower_end, upper_end)) in enumerate(rows):
        is_stored = np.isfinite(values[i])
        one = Profile(
            str(name),
            float(estimate),
            values[i, is_stored],
            drop[i, is_stored],
            others[i, is_stored],
            tuple(Interval(*numbers) for numbers in ranges),
            lower_end,
            upper_end,
        )
        found.append(one)
    missing = Mixed(is_attribute=True).load(data, "missing", path)
    return Profiles(tuple(found), missing=tuple(missing), **take_fields(data, _PROFILES, path))
