"""A torture whose trials end in every way, by the seed: to test the counting."""

from __future__ import annotations

import os
import time
from pathlib import Path

from torture import EQUAL, OTHER, Outcome, Torture


def tortures() -> list[Torture]:
    """Return that one."""
    return [Torture("ends", "ways", _trial, longest=2.0)]


def _trial(seed: int, folder: Path) -> Outcome:
    (folder / "a").write_text("x", encoding="ascii")
    if seed == 1:
        os.abort()
    if seed == 2:
        raise KeyError("not foreseen")
    if seed == 3:
        time.sleep(60)
    if seed == 4:
        bytearray(6 * 2**30)
    if seed == 5:
        return Outcome(OTHER, "1 -> 2", failed=True)
    return Outcome(EQUAL)
