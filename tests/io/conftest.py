"""A file for the text of a Nastran deck."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def deck(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes a deck."""

    def make(text: str) -> Path:
        path = tmp_path / "wing.bdf"
        path.write_text(text)
        return path

    return make
