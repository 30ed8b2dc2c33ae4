"""Time records of ASAM MDF files of version 4 (.mf4), by asammdf.

Layout: ASAM MDF 4.1. A channel group has one raster, the times of its master channel, in s.
Options are those of `updyn.io.record_groups`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from updyn.errors import FormatError
from updyn.foreign import box
from updyn.io.items import require_file, unreadable_error
from updyn.io.record_groups import build_group_records
from updyn.signals.records import Records

__all__ = ["read_records"]

#: First bytes of a file that its recorder did not finalise.
_UNFINISHED = b"UnFinMF "
#: Length of the identification block.
_HEAD_BYTES = 64


def read_records(
    path: str | Path,
    *,
    group: str | Sequence[str] | None = None,
    channels: Sequence[str] | None = None,
    rate: float | None = None,
) -> Records:
    """Read time records, one per channel group, with converted values in the units of the file."""
    _check_head(require_file(path))
    wanted = [group] if isinstance(group, str) else group
    stored = box.load(
        "updyn.foreign.mdf:load",
        path,
        None if wanted is None else list(wanted),
        what="MDF file",
        reader="asammdf",
    )
    return build_group_records(stored, path, group=group, channels=channels, time=None, rate=rate)


def _check_head(path: Path) -> None:
    """Refuse a file of another version, or that its recorder did not finalise."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise unreadable_error(path, error) from error
    if head.startswith(_UNFINISHED):
        raise FormatError(
            "was not finalised by its recorder, and may lack samples; finalise it, in Python by"
            " asammdf.MDF(file).save('new.mf4')",
            path,
        )
    if len(head) < _HEAD_BYTES:
        raise FormatError("truncated or damaged: no complete identification block", path)
    version = head[8:16].decode("latin-1").strip("\0 ")
    if not version.startswith("4."):
        raise FormatError(
            f"MDF of version {version!r}; expected version 4; convert it, in Python by"
            " asammdf.MDF(file).convert('4.10').save('new.mf4')",
            path,
        )
