"""Draws and profiles as NetCDF-4 (HDF5), exactly; the update that they are about stays in its own file.

xarray opens the file. Of draws::

    draws                                      (chain, draw, parameter), in the unit of each unknown
    estimate, std, lower, upper, is_factor     (parameter)
    diagnostic_NAME                            (parameter): r_hat, ess_bulk, ...
    attributes kind, message, converged; failed, options: JSON texts, see updyn.store.values

and of profiles, a row for each unknown that was profiled, padded with nan::

    value, drop                                (profile, point)
    others                                     (profile, point, parameter)
    estimate                                   (profile)
    attributes kind, level, threshold; humps, ends, missing, better: JSON texts
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from updyn.errors import FormatError, OptionError, suggest
from updyn.io.atomic import atomic_path
from updyn.io.hdf5 import check_kind, put_kind
from updyn.io.items import existing, library
from updyn.store.netcdf import text_of, variable
from updyn.store.values import from_text, to_text
from updyn.uncertainty.draws import KINDS, Draws
from updyn.uncertainty.profile import Hump, Profile, Profiles
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["read_uncertainty", "write_uncertainty"]

_BY_UNKNOWN = ("estimate", "std", "lower", "upper")


def write_uncertainty(found: Draws | Profiles, path: str | Path) -> None:
    """Write draws or profiles to a file, replaced as a whole once it is complete.

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
    """
    import h5py

    if not isinstance(found, Draws | Profiles):
        raise OptionError(f"expected draws or profiles, found {type(found).__name__}")
    data = _of_draws(found) if isinstance(found, Draws) else _of_profiles(found)
    with atomic_path(path) as temporary:
        data.to_netcdf(temporary, engine="h5netcdf")
        with h5py.File(temporary, "r+") as file:
            put_kind(file, "uncertainty")


def read_uncertainty(
    path: str | Path, result: UpdateResult | JointResult | None = None
) -> Draws | Profiles:
    """Read draws or profiles, as `write_uncertainty` makes them.

    Parameters
    ----------
    path : path
        The file, usually ``uncertainty.nc``.
    result : UpdateResult or JointResult, optional
        The update that draws are about (`read_result`); `updyn.predict` needs it.

    Returns
    -------
    Draws or Profiles
        Equal to what was written, but for the update.

    Raises
    ------
    FormatError
        If the file is not there, is damaged, or holds something else (the right reader is named).
    OptionError
        If the draws are about another update.
    """
    import h5py
    import xarray as xr

    path = existing(path)
    with library(path, "draws or profiles (NetCDF-4)"):
        with h5py.File(path, "r") as file:
            check_kind(file, path, "uncertainty")
        with xr.open_dataset(path, engine="h5netcdf", decode_cf=False) as data:
            data.load()
    kind = data.attrs.get("kind")
    if kind == "profile":
        return _to_profiles(data, path)
    if kind not in KINDS:
        raise FormatError(f"kind {kind!r}; {suggest(str(kind), ('profile', *KINDS))}", path)
    draws = _to_draws(data, path)
    return draws if result is None else draws.of(result)


# -- draws -------------------------------------------------------------------------------------------------
def _of_draws(found: Draws) -> xr.Dataset:
    import xarray as xr

    data = xr.Dataset(coords={"parameter": ("parameter", np.array(found.names, dtype=object))})
    data["draws"] = (("chain", "draw", "parameter"), found.chains)
    for name in _BY_UNKNOWN:
        data[name] = ("parameter", getattr(found, name))
    data["is_factor"] = ("parameter", found.is_factor.astype(np.int8))
    for name, values in found.diagnostics.items():
        data[f"diagnostic_{name}"] = ("parameter", values)
    data.attrs |= {"kind": found.kind, "message": found.message, "converged": int(found.converged)}
    data.attrs |= {
        name: to_text(dict(getattr(found, name)), name) for name in ("failed", "options")
    }
    return data


def _to_draws(data: xr.Dataset, path: Path) -> Draws:
    chains = variable(data, "draws", path)
    names = tuple(str(n) for n in variable(data, "parameter", path))
    if chains.ndim != 3 or chains.shape[2] != len(names):
        raise FormatError(
            f"draws: found shape {chains.shape}, expected (chain, draw, {len(names)})", path
        )
    prefix = "diagnostic_"
    by_unknown = {name: variable(data, name, path) for name in _BY_UNKNOWN}
    return Draws(
        kind=data.attrs["kind"],
        names=names,
        chains=chains,
        **by_unknown,
        is_factor=variable(data, "is_factor", path).astype(np.bool_),
        diagnostics={
            str(n).removeprefix(prefix): data[n].values
            for n in data.data_vars
            if str(n).startswith(prefix)
        },
        failed=from_text(text_of(data, "failed", path), "failed", path),
        converged=bool(data.attrs.get("converged")),
        message=text_of(data, "message", path),
        options=from_text(text_of(data, "options", path), "options", path),
    )


# -- profiles ----------------------------------------------------------------------------------------------
def _of_profiles(found: Profiles) -> xr.Dataset:
    import xarray as xr

    listed = list(found.values())
    points = max((len(p.values) for p in listed), default=0)
    n = listed[0].others.shape[1] if listed else 0
    table = {"value": (points,), "drop": (points,), "others": (points, n)}
    data = xr.Dataset(coords={"profile": ("profile", np.array(list(found), dtype=object))})
    for (name, shape), own in zip(table.items(), ("values", "drop", "others"), strict=True):
        padded = np.full((len(listed), *shape), np.nan)
        for row, one in zip(padded, listed, strict=True):
            row[: len(one.values)] = getattr(one, own)
        data[name] = (("profile", "point", "parameter")[: padded.ndim], padded)
    data["estimate"] = ("profile", np.array([p.estimate for p in listed]))
    humps = [[[h.lower, h.best, h.upper, h.drop] for h in p.humps] for p in listed]
    data.attrs |= {"kind": "profile", "level": found.level, "threshold": found.threshold}
    data.attrs |= {
        "humps": to_text(humps, "humps"),
        "ends": to_text([[p.lower_end, p.upper_end] for p in listed], "ends"),
        "missing": to_text(list(found.missing), "missing"),
        "better": to_text(dict(found.better), "better"),
    }
    return data


def _to_profiles(data: xr.Dataset, path: Path) -> Profiles:
    values, drop, others = (variable(data, name, path) for name in ("value", "drop", "others"))
    humps, ends, missing, better = (
        from_text(text_of(data, name, path), name, path)
        for name in ("humps", "ends", "missing", "better")
    )
    rows = zip(
        variable(data, "profile", path), variable(data, "estimate", path), humps, ends, strict=True
    )
    found = []
    for i, (name, estimate, own, (low, high)) in enumerate(rows):
        there = np.isfinite(values[i])
        ranges = tuple(Hump(*h) for h in own)
        one = Profile(
            str(name),
            float(estimate),
            values[i, there],
            drop[i, there],
            others[i, there],
            ranges,
            low,
            high,
        )
        found.append(one)
    return Profiles(
        tuple(found),
        float(data.attrs["level"]),
        float(data.attrs["threshold"]),
        tuple(missing),
        better,
    )
