"""Time records in the MATLAB export of PULSE LabShop and BK Connect (Bruel & Kjaer).

Layout, from two programs that read it (the ITA-Toolbox, and measurements with the Time Data
Recorder)::

    File_Header         struct of NumberOfChannels, SampleFrequency, NumberOfSamplesPerChannel, as
                        texts
    Channel_1_Header    struct of SignalName and Unit
    Channel_1_Data      samples, in this unit
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError
from updyn.io.items import as_vector
from updyn.io.record_groups import build_group_records
from updyn.io.text_numbers import parse_real
from updyn.io.variable_names import find_variable
from updyn.signals.records import Records

__all__ = ["build_pulse_records", "is_pulse"]

_NEEDED = ("NumberOfChannels", "SampleFrequency", "NumberOfSamplesPerChannel")


def is_pulse(variables: Mapping[str, object]) -> bool:
    """Return whether the variables of a file are those of an export."""
    head = variables.get("File_Header")
    return isinstance(head, Mapping) and set(_NEEDED) <= set(head)


def build_pulse_records(
    variables: Mapping[str, object], path: str | Path, channels: Sequence[str] | None
) -> Records:
    """Return the record of an export, of all channels or some, in the units of the file."""
    n_channels, rate, n_samples = (_positive(variables, name, path) for name in _NEEDED)
    stored = []
    for number in range(1, int(n_channels) + 1):
        head = find_variable(variables, f"Channel_{number}_Header", path)
        name = f"Channel_{number}_Data"
        values = as_vector(find_variable(variables, name, path), name, path)
        if len(values) != n_samples:
            raise FormatError(
                f"{name} has {len(values)} samples; expected {n_samples:g}, as File_Header states",
                path,
            )
        stored.append(
            {
                "name": _text(head, "SignalName", number, path),
                "unit": _text(head, "Unit", number, path),
                "n_samples": len(values),
                "step": 1.0 / rate,
                "start": "",
                "abscissa": "s",
                "values": values,
            }
        )
    group = {"name": "File_Header", "channels": stored}
    return build_group_records([group], path, group=None, channels=channels, time=None, rate=None)


def _positive(variables: Mapping[str, Any], name: str, path: str | Path) -> float:
    """Return a number of the header, which is stored as text or as a number."""
    stored = variables["File_Header"][name]
    text = str(np.asarray(stored).reshape(-1)[0]) if np.size(stored) else ""
    try:
        number = parse_real(text)
    except ValueError as error:
        raise FormatError(f"File_Header: {name}: {error}", path) from error
    if number <= 0.0:
        raise FormatError(f"File_Header: {name} is {text!r}; expected a number above 0", path)
    return number


def _text(head: object, name: str, number: int, path: str | Path) -> str:
    if not isinstance(head, Mapping) or name not in head:
        raise FormatError(f"Channel_{number}_Header: no field {name!r}", path)
    return str(np.asarray(head[name]).reshape(-1)[0]).strip() if np.size(head[name]) else ""
