"""docs/nonlinear.md: its example runs, and its elements are those of the registry."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from pages import ROOT, blocks, run_python
from updyn.dynamics.periodic.settings import BALANCE
from updyn.dynamics.settings import LINE_SOLVER
from updyn.nonlinear import ELEMENTS

PAGE = ROOT / "docs" / "nonlinear.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_example_runs_and_folds() -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/nonlinear.md", namespace)
    found = namespace["found"]
    (branch,) = found.branches
    assert (np.diff(branch.freq) < 0.0).any()
    assert not branch.stable.all()
    assert found.stable.all()
    assert namespace["change"].is_nonlinear
    best = namespace["location"].best
    assert (best.place, best.kind) == ("joint", "cubic-spring")
    assert namespace["location"].distinguishable
    result, wanted = namespace["result"], {"springs.stiffness": 1.2, "joint.coefficient": 3e8}
    for name, value in wanted.items():
        assert abs(result.values[name] - value) < 1e-3 * value
    levels = namespace["levels"]
    assert [one.level for one in levels.candidates] == [0.25, 0.5, 1.0, 2.0, 4.0]
    assert levels.best.level == 4.0


def test_every_element_is_on_the_page() -> None:
    table = TEXT.split("## Elements")[1].split("\n\n")[1]
    named = set(re.findall(r"^\| `(\w+)\(", table, re.MULTILINE))
    assert named == {ELEMENTS[name].__name__ for name in ELEMENTS}


def test_numbers_are_those_of_the_settings() -> None:
    words = " ".join(TEXT.split())
    assert f"of the model up to {LINE_SOLVER.dense_dofs} degrees of freedom" in words
    assert f"up to the harmonic H + {BALANCE.next_harmonics}" in words
    assert f"A warning above {100 * BALANCE.largest_truncation:.0f} %" in words
