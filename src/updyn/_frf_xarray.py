"""An `FRF` as an `xarray.Dataset` and back: the one place that knows the names of its variables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.errors import DataError, suggest
from updyn.geometry import Geometry

if TYPE_CHECKING:
    import xarray as xr

    from updyn.frf import FRF

_DIMS = ("freq", "response", "reference")


def to_dataset(frf: FRF) -> xr.Dataset:
    """Return the dataset; see `FRF.to_xarray`."""
    import xarray as xr

    data = {"frf": (_DIMS, frf.values)}
    for name in ("coherence", "variance"):
        if getattr(frf, name) is not None:
            data[name] = (_DIMS, getattr(frf, name))
    attrs: dict[str, Any] = {"quantity": frf.quantity, "source": frf.source}
    if frf.averages is not None:
        attrs["averages"] = frf.averages
    coords = {
        "freq": frf.freq,
        "response": frf.responses.labels,
        "reference": frf.references.labels,
    }
    out = xr.Dataset(data, coords=coords, attrs=attrs)
    out["freq"].attrs["units"] = "Hz"
    if frf.geometry is not None:
        out["node"] = ("node", frf.geometry.nodes)
        out["xyz"] = (("node", "axis"), frf.geometry.xyz, {"units": "m"})
        if len(frf.geometry.lines):
            out["trace"] = (("trace_line", "end"), frf.geometry.lines)
        if frf.geometry.axes is not None:
            out["node_axes"] = (("node", "direction", "axis"), frf.geometry.axes)
    return out


def from_dataset(data: xr.Dataset, quantity: str | None) -> dict[str, Any]:
    """Return the arguments of the `FRF` that the dataset holds; see `FRF.from_xarray`."""
    for name in ("frf", *_DIMS):
        if name not in data.variables:
            raise DataError(
                f"dataset: no variable {name!r}; {suggest(name, map(str, data.variables))}"
            )
    said = data.attrs.get("quantity")
    if said is None and quantity is None:
        raise DataError(
            "the dataset does not say what it measured: give quantity='receptance', 'mobility' or"
            " 'accelerance'"
        )
    if said is not None and quantity is not None and said != quantity:
        raise DataError(f"quantity {quantity!r} contradicts the dataset, which says {said!r}")
    unit = data["freq"].attrs.get("units", "Hz")
    if unit != "Hz":
        raise DataError(f"dataset: freq is in {unit!r}; expected 'Hz'")
    arrays: dict[str, Any] = {}
    for name in ("frf", "coherence", "variance"):
        if name in data.variables:
            if set(data[name].dims) != set(_DIMS):
                raise DataError(
                    f"dataset: {name!r} has dimensions {data[name].dims}; expected {_DIMS}"
                )
            arrays[name] = data[name].transpose(*_DIMS).values
    averages = data.attrs.get("averages")
    return {
        "freq": data["freq"].values,
        "values": arrays.pop("frf"),
        "responses": [str(x) for x in data["response"].values],
        "references": [str(x) for x in data["reference"].values],
        "quantity": str(said or quantity),
        **arrays,
        "averages": None if averages is None else int(averages),
        "geometry": _geometry(data),
        "source": str(data.attrs.get("source", "")),
    }


def _geometry(data: xr.Dataset) -> Geometry | None:
    if "xyz" not in data.variables:
        return None
    if "node" not in data.variables:  # xarray would make up 0, 1, 2, ...
        raise DataError("dataset: 'xyz' without 'node', the numbers of the nodes")
    lines = data["trace"].values if "trace" in data.variables else np.empty((0, 2))
    axes = data["node_axes"].values if "node_axes" in data.variables else None
    return Geometry(data["node"].values, data["xyz"].transpose("node", "axis").values, lines, axes)
