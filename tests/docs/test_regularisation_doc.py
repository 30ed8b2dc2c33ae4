"""docs/regularisation.md runs as it stands, and names the constants of the code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pages import ROOT, blocks, run_python
from updyn.updating.fit import regularisation as regularise
from updyn.updating.fit.methods import methods_with
from updyn.updating.fit.settings import REGULARISATION
from updyn.updating.judge.settings import SEPARATION

NAME = "docs/regularisation.md"
TEXT = " ".join((ROOT / NAME).read_text(encoding="utf-8").split())


def test_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "page"}
    python = [block for block in blocks(ROOT / NAME) if block.language == "python"]
    assert len(python) >= 3
    for block in python:
        run_python(block, NAME, namespace)


ABLE = methods_with("can_regularise")


@pytest.mark.parametrize(
    "said",
    [
        f"`max_collinearity` ({SEPARATION.most_collinearity:g})",
        f"threshold ({SEPARATION.least_cosine:g})",
        f"a prior of a factor e (strength {REGULARISATION.weakest:g})",
        f"stays within {100 * REGULARISATION.settled_log:g} %",
        "Methods: " + ", ".join(ABLE) + ".",
        *(f'`"{choice}"`' for choice in regularise.CHOICES),
    ],
)
def test_constants_are_as_documented(said: str) -> None:
    assert said in TEXT
