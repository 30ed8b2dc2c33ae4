"""How much time and memory the reading of a file of another program may take, by its size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from updyn.errors import FormatError

__all__ = ["Limits", "limits_of"]

_MB = 10**6
_SECONDS = 6.0
_BYTES_PER_SECOND = 1 * _MB
_UNPACKED = 256 * _MB
_RATIO = 100
_WORKING = 512 * _MB


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for one file.

    Parameters
    ----------
    path : str
        The file.
    size : int
        Its size in bytes.
    """

    path: str
    size: int

    @property
    def seconds(self) -> float:
        """Time that reading may take, in s."""
        return _SECONDS + self.size / _BYTES_PER_SECOND

    @property
    def unpacked(self) -> int:
        """Bytes that all it holds may have, unpacked."""
        return _UNPACKED + _RATIO * self.size

    @property
    def memory(self) -> int:
        """Bytes of memory that the reader may take, beside its program."""
        return _WORKING + 2 * self.unpacked

    def check(self, unpacked: int) -> None:
        """Refuse a file whose content is larger than its size lets one expect.

        Parameters
        ----------
        unpacked : int
            Bytes that it says that it holds, so far.

        Raises
        ------
        FormatError
            If these are too many.
        """
        if unpacked > self.unpacked:
            raise FormatError(
                f"says that it holds {unpacked / _MB:,.0f} MB or more; expected"
                f" {self.unpacked / _MB:,.0f} MB at most in a file of {self.size / _MB:,.3f} MB of"
                " another program: damaged, or made to take all memory",
                self.path,
            )


def limits_of(path: str | Path, beside: Iterable[str | Path] = ()) -> Limits:
    """Return the limits for a file.

    Parameters
    ----------
    path : path
        The file.
    beside : iterable of path
        Files that are read with it.

    Raises
    ------
    FormatError
        If one is not there or cannot be looked at.
    """
    try:
        return Limits(str(path), sum(Path(p).stat().st_size for p in (path, *beside)))
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path) from error
