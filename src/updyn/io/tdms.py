"""Time records of NI TDMS files (.tdms), by npTDMS; options are those of `updyn.io.record_groups`.

Layout: National Instruments, "TDMS File Format Internal Structure". The waveform properties of a
channel (``wf_increment``, ``wf_start_time``, ``wf_start_offset``, ``unit_string``) state its step,
start and unit.
"""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path

from updyn.errors import FormatError, UpdynWarning
from updyn.foreign import box
from updyn.io.items import require_file, unreadable_error
from updyn.io.record_groups import build_group_records
from updyn.signals.records import Records

__all__ = ["read_records"]

_TAG = b"TDSm"
#: Tag, flags, version, and the lengths of the segment and of its description.
_HEAD = struct.Struct("<4sIIQQ")
_BIG_ENDIAN_FLAG = 1 << 6
_INCOMPLETE = 2**64 - 1


def read_records(
    path: str | Path,
    *,
    group: str | Sequence[str] | None = None,
    channels: Sequence[str] | None = None,
    time: str | None = None,
    rate: float | None = None,
) -> Records:
    """Read time records, one per group, with scaled values in the units of the file."""
    _check_segments(require_file(path))
    wanted = [group] if isinstance(group, str) else group
    stored = box.load(
        "updyn.foreign.tdms:load",
        path,
        None if wanted is None else list(wanted),
        what="TDMS file",
        reader="npTDMS",
    )
    found = build_group_records(stored, path, group=group, channels=channels, time=time, rate=rate)
    if found.step == 1.0 and time is None and rate is None:
        warnings.warn(
            f"{path}: wf_increment is 1 s, which LabVIEW also writes for data without a sampling"
            " rate; check that the rate is one sample per second",
            UpdynWarning,
            stacklevel=4,
        )
    return found


def _check_segments(path: Path) -> None:
    """Refuse a file whose segments do not fill it, because the library would return a part."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            at, number = 0, 0
            while at < size:
                number += 1
                place = f"segment {number} at byte {at}"
                file.seek(at)
                head = file.read(_HEAD.size)
                if len(head) < _HEAD.size or not head.startswith(_TAG):
                    raise FormatError(f"truncated or damaged: {place} has no complete head", path)
                _, flags, *_, length, _ = _HEAD.unpack(head)
                if flags & _BIG_ENDIAN_FLAG:
                    length = struct.unpack_from(">Q", head, 12)[0]
                if length == _INCOMPLETE:
                    raise FormatError(
                        f"{place} was not completed by its recorder, and may lack samples", path
                    )
                at += _HEAD.size + length
                if at > size:
                    raise FormatError(
                        f"truncated or damaged: {place} declares {length} bytes,"
                        f" {size - at + length} remain",
                        path,
                    )
    except OSError as error:
        raise unreadable_error(path, error) from error
