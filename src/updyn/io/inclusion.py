"""Limits on files that include other files.

A deck that includes a file twice, which does the same with the next one, doubles with every file:
24 files of two lines are 16 million lines.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["DEEPEST", "Inclusions"]

#: Largest depth of files that include files: the lines of each level are in memory.
DEEPEST = 20
#: Largest number of repeated inclusions, and of their lines: a deck may include a file with few
#: lines for each of many parts, but its size may not grow exponentially.
_REPEATS = 100
_REPEATED_LINES = 1_000_000


class Inclusions:
    """The files that a deck has included so far."""

    def __init__(self) -> None:
        self._seen: set[Path] = set()
        self._repeats = 0
        self._lines = 0

    def excess(self, path: Path, lines: int) -> str | None:
        """Count an inclusion; return the limit that it exceeds, None if it exceeds no limit.

        Parameters
        ----------
        path : Path
            The file that is included, resolved.
        lines : int
            Its number of lines.

        Returns
        -------
        str or None
            The limit, for a message.
        """
        if path not in self._seen:
            self._seen.add(path)
            return None
        self._repeats += 1
        self._lines += lines
        if self._repeats > _REPEATS:
            return f"files are included again more than {_REPEATS} times"
        if self._lines > _REPEATED_LINES:
            return f"files that are included again have more than {_REPEATED_LINES} lines in all"
        return None
