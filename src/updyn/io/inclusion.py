"""Limits on files that include other files.

If each file includes the next one twice, 24 files of two lines have 16 million lines.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["DEEPEST", "Inclusions"]

#: Largest depth of nested inclusions: the lines of each level are in memory.
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
        """Count an inclusion of a resolved path; return the exceeded limit as text, or None."""
        if path not in self._seen:
            self._seen.add(path)
            return None
        self._repeats += 1
        self._lines += lines
        if self._repeats > _REPEATS:
            return f"more than {_REPEATS} repeated inclusions"
        if self._lines > _REPEATED_LINES:
            return f"repeated inclusions have more than {_REPEATED_LINES} lines in total"
        return None
