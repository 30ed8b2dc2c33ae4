"""Time records of NI TDMS files as plain data, by npTDMS."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import OptionError
from updyn.foreign.limits import limits_of
from updyn.foreign.plain import Other, to_native

try:
    from nptdms import TdmsChannel, TdmsFile
except ImportError as error:
    raise OptionError(
        f"TDMS files are read by npTDMS, which cannot be loaded ({error}): pip install"
        " 'updyn[records]'"
    ) from error

__all__ = ["load"]


def load(path: str, wanted: Sequence[str] | None) -> list[dict[str, object]]:
    """Load the groups of a file, with values for the `wanted` groups; None: for a single group.

    Steps and offsets of the first sample are in the unit of the abscissa; None if not stated.
    """
    limits = limits_of(path)
    # An open file, because npTDMS would trust an index file of the same name.
    with Path(path).open("rb") as file, _open(file) as found:
        groups = [group for group in found.groups() if group.channels()]
        if wanted is None:
            wanted = [group.name for group in groups] if len(groups) == 1 else []
        loaded: list[dict[str, Any]] = []
        n_values = 0
        for group in groups:
            channels = []
            for channel in group.channels():
                stored = _describe(channel)
                if group.name in wanted:
                    n_values += len(channel)
                    limits.check(8 * n_values)
                    stored["values"] = _values(channel)
                channels.append(stored)
            loaded.append({"name": group.name, "channels": channels})
        return loaded


def _open(file: BinaryIO) -> TdmsFile:
    """Open a file and read only its description."""
    return TdmsFile(file, read_metadata_only=True, keep_open=True)


def _describe(channel: TdmsChannel) -> dict[str, object]:
    """Return name, unit, length and timing of a channel."""
    stated = channel.properties
    unit = stated.get("unit_string") or stated.get("NI_UnitDescription") or ""
    is_spectrum = str(stated.get("wf_xname", "")).casefold() == "frequency"
    return {
        "name": channel.name,
        "unit": "s" if channel.dtype.kind == "M" else str(unit),
        "n_samples": len(channel),
        "step": _number(stated.get("wf_increment")),
        "offset": _number(stated.get("wf_start_offset")) or 0.0,
        "start": str(stated.get("wf_start_time", "")),
        "abscissa": str(stated.get("wf_xunit_string") or ("Hz" if is_spectrum else "s")),
    }


def _number(stated: Any) -> float | None:
    return None if stated is None else float(stated)


def _values(channel: TdmsChannel) -> NumberArray | Other:
    """Return the scaled samples of a channel; of times of day, the seconds since the first."""
    values = np.asarray(channel[:])
    if values.dtype.kind == "M":
        values = (values - values[:1]) / np.timedelta64(1, "s")
    return to_native(values) if values.dtype.kind in "biuf" else Other(str(values.dtype))
