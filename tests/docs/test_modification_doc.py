"""docs/modification.md: its example runs, and its attributes exist."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

import updyn
from pages import ROOT, blocks, run_python

PAGE = ROOT / "docs" / "modification.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_example_lowers_the_modes() -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/modification.md", namespace)
    assert all(mode.change < 0.0 for mode in namespace["found"].modes)
    assert np.isfinite(namespace["frf_change"].std_db).all()


def test_every_attribute_exists() -> None:
    table = TEXT.split("| attribute | value |")[1].split("\n\n")[0]
    known: set[str] = set()
    for kind in (updyn.Modification, updyn.ModeChange, updyn.FRFChange):
        known |= set(dir(kind)) | set(kind.__dataclass_fields__)
    names = set(re.findall(r"`\.(\w+)", table))
    assert len(names) > 8
    assert names <= known
