"""FRFs and time records of Rattlesnake, the vibration controller of Sandia, in netCDF-4.

Layout, from its source code (``components/streaming.py`` and ``components/modal_environment.py``,
January 2025): variables ``time_data``, ``time_data_1``, ... of channels and samples, one for each
stream; the attribute ``sample_rate``; and the group ``channels``, a table with a text for each
channel. The file of a modal test has one stream of frames, ``samples_per_frame`` each, and FRFs
(lines, responses, references) in the group of its environment, with the numbers of their channels.
All channels have the same window.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import FormatError
from updyn.frf import FRF
from updyn.io.items import as_number, as_reals, locate_errors
from updyn.io.ratio import Ratio
from updyn.io.record_groups import build_group_records
from updyn.signals.records import Records
from updyn.units import find_unit, split_ratio

__all__ = [
    "build_rattlesnake_frf",
    "build_rattlesnake_records",
    "holds_frf",
    "is_rattlesnake",
]

_STREAM = re.compile(r"time_data(_[0-9]+)?")
_DIRECTION = re.compile(r"([+-]?)(R?[XYZ])([+-]?)")
_TEXTS = ("node_number", "node_direction", "comment", "unit")


def is_rattlesnake(names: Mapping[str, object], attributes: Mapping[str, object]) -> bool:
    """Return whether a file with these members and attributes has the layout."""
    return {"time_data", "channels"} <= set(names) and "sample_rate" in attributes


def build_rattlesnake_records(
    root: Mapping[str, Any],
    path: str | Path,
    *,
    group: str | Sequence[str] | None,
    channels: Sequence[str] | None,
) -> Records:
    """Return the records of a loaded file: one per stream, or per frame of a modal test."""
    # A channel has the name of its DOF, with " force" if it measures a force.
    members = root["members"]
    rate = _sample_rate(root, path)
    table = _read_table(members["channels"], path)
    stored = []
    for name, item in sorted(members.items()):
        if not _STREAM.fullmatch(name):
            continue
        values = np.atleast_2d(as_reals(item, name, path))
        if values.shape[0] != len(table):
            raise FormatError(
                f"{name} has {values.shape[0]} channels; the group channels has {len(table)}", path
            )
        stored.append(
            {
                "name": name,
                "channels": [
                    {
                        "name": channel.name,
                        "unit": channel.unit,
                        "n_samples": row.size,
                        "step": 1.0 / rate,
                        "start": "",
                        "abscissa": "s",
                        "values": row,
                    }
                    for channel, row in zip(table, values, strict=True)
                ],
            }
        )
    found = build_group_records(stored, path, group=group, channels=channels, time=None, rate=None)
    modal = _modal_group(members)
    return found if modal is None else _split_frames(found, _frame_length(modal, path), path)


def holds_frf(root: Mapping[str, Any]) -> bool:
    """Return whether a loaded file is that of a modal test, with FRFs."""
    return _modal_group(root["members"]) is not None


def build_rattlesnake_frf(
    root: Mapping[str, Any],
    path: str | Path,
    *,
    quantity: str | None,
    response_labels: Iterable[str | Dof] | None,
    reference_labels: Iterable[str | Dof] | None,
) -> FRF:
    """Return the FRFs of a modal test, in SI units by the units of the channel table."""
    # The coherence is that of a response with all references, and is read for one reference only.
    modal = _modal_group(root["members"])
    assert modal is not None
    table = _read_table(root["members"]["channels"], path)
    responses = _listed_channels(modal, "response", table, path)
    references = _listed_channels(modal, "reference", table, path)
    real, imaginary = (_array(modal, f"frf_data_{part}", path) for part in ("real", "imag"))
    shape = (real.shape[0], len(responses), len(references))
    if real.shape != shape or imaginary.shape != shape:
        raise FormatError(
            f"frf_data_real of shape {real.shape}, frf_data_imag {imaginary.shape}; expected"
            f" (lines, {shape[1]}, {shape[2]}) for the responses and references",
            path,
        )
    found = _find_quantity(responses, references, quantity, path)
    rows = _dofs(responses, response_labels, "response_labels", path)
    columns = _dofs(references, reference_labels, "reference_labels", path)
    ratios = [[_ratio(i, j, path) for j in references] for i in responses]
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            ratios[i][j].check((row, column), path, remedy="correct the units or the labels")
    factors = np.array([[ratio.factor for ratio in of_response] for of_response in ratios])
    rate, frame = _sample_rate(root, path), _frame_length(modal, path)
    n_frames = as_reals(root["members"]["time_data"], "time_data", path).shape[-1] // frame
    if not n_frames:
        raise FormatError("holds no accepted frame, and therefore no FRFs", path)
    coherence = None
    if len(references) == 1 and "coherence" in modal["members"]:
        coherence = _array(modal, "coherence", path)[..., None]
    with locate_errors(path):
        return FRF(
            np.arange(shape[0]) * rate / frame,
            factors * (real + 1j * imaginary),
            rows,
            columns,
            found,
            coherence=coherence,
            averages=_count_averages(modal, n_frames, path),
            source=Path(path).name,
            decay=_window_decay(modal, rate / frame, path),
        )


def _listed_channels(
    modal: Mapping[str, object], side: str, table: Sequence[_Channel], path: str | Path
) -> list[_Channel]:
    """Return the responses or the references of a modal test."""
    name = f"{side}_channel_indices"
    indices = np.atleast_1d(_array(modal, name, path)).astype(int)
    if not indices.size or indices.min() < 0 or indices.max() >= len(table):
        raise FormatError(
            f"{name} {indices.tolist()}; expected numbers from 0 to {len(table) - 1}", path
        )
    return [table[index] for index in indices]


def _array(modal: Mapping[str, Any], name: str, path: str | Path) -> RealArray:
    if name not in modal["members"]:
        raise FormatError(f"the group of the modal test has no variable {name!r}", path)
    return np.asarray(as_reals(modal["members"][name], name, path), dtype=np.float64)


def _ratio(response: _Channel, reference: _Channel, path: str | Path) -> Ratio:
    label = f"{response.unit}/{reference.unit}"
    found = split_ratio(label)
    if found is None or found[1].kind != "force":
        raise FormatError(
            f"FRF of {response.name!r} in {response.unit!r} over {reference.name!r} in"
            f" {reference.unit!r}; expected a motion over a force, in known units",
            path,
        )
    return Ratio(label, *found)


def _find_quantity(
    responses: Sequence[_Channel],
    references: Sequence[_Channel],
    stated: str | None,
    path: str | Path,
) -> str:
    by_quantity: dict[str, list[str]] = {}
    for response in responses:
        for reference in references:
            quantity = _ratio(response, reference, path).quantity
            by_quantity.setdefault(quantity, []).append(response.name)
    if len(by_quantity) > 1:
        texts = [f"{kind} of {', '.join(names)}" for kind, names in by_quantity.items()]
        raise FormatError(f"FRFs of several quantities: {'; '.join(texts)}", path)
    (found,) = by_quantity
    if stated is not None and stated != found:
        raise FormatError(
            f"quantity {stated!r} contradicts the units of the file, which are those of {found}",
            path,
            key=("quantity",),
        )
    return found


def _dofs(
    channels: Sequence[_Channel],
    given: Iterable[str | Dof] | None,
    option: str,
    path: str | Path,
) -> DofSet:
    """Return the DOFs of channels, from labels or from the channel table."""
    labels = [channel.label for channel in channels] if given is None else list(given)
    unlabelled = [c.name for c, label in zip(channels, labels, strict=False) if not label]
    if unlabelled or len(labels) != len(channels):
        raise FormatError(
            f"channels {', '.join(c.name for c in channels)}: expected a node number and a"
            f" direction of X Y Z RX RY RZ for each; or state {option}, one for each",
            path,
            key=(option,),
        )
    return DofSet(labels)


def _count_averages(modal: Mapping[str, Any], n_frames: int, path: str | Path) -> int | None:
    """Return the number of linear averages without overlap; None otherwise."""
    # num_averages is the wanted number; a test that was stopped has fewer frames.
    stated = modal["attributes"]
    if str(stated.get("averaging_type")) != "Linear" or "num_averages" not in stated:
        return None
    if as_number(stated.get("overlap", 0.0), "overlap", path) != 0.0:
        return None
    return min(int(as_number(stated["num_averages"], "num_averages", path)), n_frames)


def _window_decay(modal: Mapping[str, Any], frames_per_second: float, path: str | Path) -> float:
    """Return the decay in 1/s of an exponential window on all channels; 0 for other windows."""
    stated = modal["attributes"]
    if str(stated.get("frf_window")) != "exponential":
        return 0.0
    name = "exponential_window_value_at_frame_end"
    end = as_number(stated.get(name, np.nan), name, path)
    if not 0.0 < end <= 1.0:
        raise FormatError(f"{name} {end:g}; expected a number above 0, and 1 at most", path)
    return -float(np.log(end)) * frames_per_second


@dataclass(frozen=True, slots=True)
class _Channel:
    """A row of the channel table; the label is empty if its texts are not a DOF."""

    label: str
    texts: str
    unit: str

    @property
    def name(self) -> str:
        is_force = bool(self.label) and find_unit(self.unit, "force") is not None
        return (self.label or self.texts) + (" force" if is_force else "")


def _read_table(table: object, path: str | Path) -> list[_Channel]:
    members = table.get("members", {}) if isinstance(table, Mapping) else {}
    columns = []
    for name in _TEXTS:
        texts = members.get(name)
        if not isinstance(texts, np.ndarray) or texts.dtype.kind not in "OU" or texts.ndim != 1:
            raise FormatError(f"channels: expected the column {name!r} of texts", path)
        columns.append([str(text).strip() for text in texts])
    channels = []
    for number, (node, direction, comment, unit) in enumerate(zip(*columns, strict=True), 1):
        texts = f"{node} {direction}".strip() or comment or f"channel {number}"
        channels.append(_Channel(_find_label(node, direction), texts, unit))
    return channels


def _find_label(node: str, direction: str) -> str:
    """Return the label of a DOF from its node and a direction such as ``Z-``; empty if invalid."""
    found = _DIRECTION.fullmatch(direction.replace(" ", "").upper())
    if found is None or not node.isdecimal() or (found[1] and found[3]):
        return ""
    sign = "-" if "-" in (found[1], found[3]) else ""
    return f"{int(node)}:{sign}{found[2]}"


def _sample_rate(root: Mapping[str, Any], path: str | Path) -> float:
    rate = as_number(root["attributes"]["sample_rate"], "sample_rate", path)
    if not (np.isfinite(rate) and rate > 0.0):
        raise FormatError(f"sample_rate {rate:g}; expected samples per second, above 0", path)
    return rate


def _modal_group(members: Mapping[str, object]) -> Mapping[str, Any] | None:
    """Return the group of a modal test; None for continuous streams."""
    for item in members.values():
        if isinstance(item, Mapping) and "frf_data_real" in item["members"]:
            return item
    return None


def _frame_length(modal: Mapping[str, Any], path: str | Path) -> int:
    name = "samples_per_frame"
    if name not in modal["attributes"]:
        raise FormatError(f"the group of the modal test has no attribute {name!r}", path)
    frame = int(as_number(modal["attributes"][name], name, path))
    if frame < 1:
        raise FormatError(f"{name} {frame}; expected 1 or more", path)
    return frame


def _split_frames(records: Records, frame: int, path: str | Path) -> Records:
    _, n_channels, n_samples = records.values.shape
    if n_samples % frame:
        raise FormatError(f"{n_samples} samples in frames of {frame}; expected whole frames", path)
    frames = records.values.reshape(-1, n_channels, n_samples // frame, frame)
    values = frames.transpose(0, 2, 1, 3).reshape(-1, n_channels, frame)
    with locate_errors(path):
        return Records.of(values, records.step, records.channels, records.units, records.source)
