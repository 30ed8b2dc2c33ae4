"""Limits on files that include other files.

If each file includes the next one twice, 24 files of two lines have 16 million lines.
"""

from __future__ import annotations

from pathlib import Path

from updyn.io.settings import DECK

__all__ = ["Inclusions"]


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
        if self._repeats > DECK.repeated_inclusions:
            return f"more than {DECK.repeated_inclusions} repeated inclusions"
        if self._lines > DECK.repeated_lines:
            return f"repeated inclusions have more than {DECK.repeated_lines} lines in total"
        return None
