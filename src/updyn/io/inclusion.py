"""Limits on files that include other files.

A deck that includes a file twice, which does the same with the next one, doubles with every file:
24 files of two lines are 16 million lines.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["DEEPEST", "Inclusions"]

#: Largest depth of files that include files.
DEEPEST = 20
#: Largest number of inclusions of files that were included before, and of lines in these.
_REPEATS = 100
_REPEATED_LINES = 1_000_000


class Inclusions:
    """The files that a deck has included so far."""

    def __init__(self) -> None:
        self._seen: set[Path] = set()
        self._repeats = 0
        self._lines = 0

    def excess(self, path: Path, lines: int) -> str | None:
        """Count an inclusion; return why it is one too many, None if it is not.

        Parameters
        ----------
        path : Path
            The file that is included, resolved.
        lines : int
            Its number of lines.

        Returns
        -------
        str or None
            For a message.
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
