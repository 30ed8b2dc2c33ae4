"""Measured modes in the record of a run: a `ModeSet` as variables ``measured_NAME``.

``measured_frequency`` in Hz, ``measured_loss_factor``, ``measured_quality``, ``measured_scaled``,
``measured_std_frequency`` and ``measured_std_loss_factor`` over ``measured_mode``;
``measured_shapes`` over (measured_dof, measured_mode, part), real and imaginary part, and
``measured_std_shapes``, if known, over the first two. ``measured_cov_frequency``, if known, in Hz^2
over ``measured_mode`` and ``measured_other_mode``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.modal import ModeSet
from updyn.store.netcdf import texts, variable

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["put_mode_set", "take_mode_set"]

_ROWS = ("frequency", "loss_factor", "quality", "std_frequency", "std_loss_factor")
_MODE, _OTHER, _DOF = "measured_mode", "measured_other_mode", "measured_dof"


def put_mode_set(modes: ModeSet) -> xr.Dataset:
    """Return modes as a dataset, the start of a record; the stabilisation diagram is not stored."""
    import xarray as xr

    data = xr.Dataset()
    data.coords[_DOF] = (_DOF, texts(modes.dofs.labels))
    for name in _ROWS:
        unit = {"units": "Hz"} if name.endswith("frequency") else {}
        data[f"measured_{name}"] = (_MODE, getattr(modes, name), unit)
    data["measured_scaled"] = (_MODE, modes.scaled.astype(np.int8))
    shapes = np.stack([modes.shapes.real, modes.shapes.imag], axis=-1)
    data["measured_shapes"] = ((_DOF, _MODE, "part"), shapes)
    if modes.std_shapes is not None:
        data["measured_std_shapes"] = ((_DOF, _MODE), modes.std_shapes)
    if modes.cov_frequency is not None:
        square = {"units": "Hz^2"}
        data["measured_cov_frequency"] = ((_MODE, _OTHER), modes.cov_frequency, square)
    data["measured_source"] = ((), modes.source)
    return data


def take_mode_set(data: xr.Dataset, path: Path) -> ModeSet | None:
    """Return the modes of a record, or None if it contains FRFs; refuse incomplete modes."""
    if "measured_frequency" not in data.variables:
        return None
    rows: dict[str, Any] = {name: variable(data, f"measured_{name}", path) for name in _ROWS}
    shapes = variable(data, "measured_shapes", path)
    for name in ("std_shapes", "cov_frequency"):
        if f"measured_{name}" in data.variables:
            rows[name] = variable(data, f"measured_{name}", path)
    return ModeSet(
        shapes=shapes[..., 0] + 1j * shapes[..., 1],
        dofs=map(str, variable(data, _DOF, path)),
        scaled=variable(data, "measured_scaled", path).astype(np.bool_),
        source=str(variable(data, "measured_source", path)),
        **rows,
    )
