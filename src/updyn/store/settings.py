"""Numbers that limit what is stored."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StoredArraySettings:
    """Arrays in stored results."""

    #: [bytes] Largest entry of an array. Drawing: a fixed length for all texts of an array with one
    #: long text would be mostly padding.
    entry_bytes: int = 4096


STORED_ARRAY = StoredArraySettings()
