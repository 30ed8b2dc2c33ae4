"""Limits of time and memory for reading a file of another program, by its size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from updyn.errors import FormatError
from updyn.foreign.settings import READING

__all__ = ["ReadLimits", "limits_of"]

_MB = 10**6


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Limits for one file, by its size in bytes."""

    path: str
    size: int

    @property
    def seconds(self) -> float:
        """Time limit of reading, in s."""
        return READING.seconds + self.size / READING.bytes_per_second

    @property
    def max_unpacked(self) -> int:
        """Largest size of the unpacked content, in bytes."""
        return READING.unpacked_bytes + READING.packing_ratio * self.size

    @property
    def memory(self) -> int:
        """Memory limit of the reader in addition to its program, in bytes."""
        return READING.working_bytes + 2 * self.max_unpacked

    def check(self, unpacked: int) -> None:
        """Refuse a file with more unpacked content (bytes so far) than its size suggests."""
        if unpacked > self.max_unpacked:
            raise FormatError(
                f"declares {unpacked / _MB:,.0f} MB of data or more; expected at most"
                f" {self.max_unpacked / _MB:,.0f} MB in a file of {self.size / _MB:,.3f} MB of"
                " another program: damaged, or made to take all memory",
                self.path,
            )


def limits_of(path: str | Path, extra_files: Iterable[str | Path] = ()) -> ReadLimits:
    """Return the limits for a file; `extra_files` are read with it."""
    try:
        return ReadLimits(str(path), sum(Path(p).stat().st_size for p in (path, *extra_files)))
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path) from error
