"""docs/damping.md: its code runs, block after block, and what it says of names is so."""

from __future__ import annotations

import re
from typing import Any

from pages import ROOT, blocks, run_python
from updyn.group import GROUP_QUANTITIES, VALUES
from updyn.updating.fit.methods import methods_with

PAGE = ROOT / "docs" / "damping.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_runs() -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    shown = [block for block in blocks(PAGE) if block.language == "python"]
    assert len(shown) == 6
    for block in shown:
        run_python(block, "docs/damping.md", namespace)


def test_every_kind_of_damping_is_in_the_table() -> None:
    table = TEXT.split("|---|---|---|---|")[1].split("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", table))
    assert named == {*GROUP_QUANTITIES, "loss_table"} - {"stiffness", "mass"}
    assert VALUES == {"loss_factor": "", "mass_damping": "1/s", "stiffness_damping": "s"}


def test_the_methods_that_know_calibration_are_those() -> None:
    knowing = set(methods_with("calibrates"))
    said = TEXT.split("- **Methods.**")[1].split("Others work")[0]
    assert set(re.findall(r"`([\w-]+)`", said)) == knowing
