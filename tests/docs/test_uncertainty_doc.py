"""docs/uncertainty.md: its blocks run in order, and what it says of defaults is so."""

from __future__ import annotations

import contextlib
import inspect
import io
import re
from pathlib import Path
from typing import Any

import pytest

import updyn
from pages import ROOT, blocks, run_python
from updyn.uncertainty.settings import BOOTSTRAP, POSTERIOR_SEARCH, PREDICTED_BAND, SAMPLER

PAGE = ROOT / "docs" / "uncertainty.md"
TEXT = " ".join(PAGE.read_text(encoding="utf-8").split())


def test_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("emcee")
    pytest.importorskip("arviz_stats")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "page"}
    with contextlib.redirect_stdout(io.StringIO()) as out:
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, PAGE.name, names)
    assert "zero is among the values that the data allow" in out.getvalue()
    (table,) = (block.text for block in blocks(PAGE) if "combined modes" in block.text)
    assert table.strip() in out.getvalue()
    assert names["posterior"].converged
    assert '<section id="uncertainty">' in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "said",
    [
        f"(`starts={POSTERIOR_SEARCH.starts}`; 0 leaves it out)",
        f"If it is above {SAMPLER.most_r_hat:g}",
        f"up to {PREDICTED_BAND.most_draws} of them",
        f"more than {100 * BOOTSTRAP.most_failed_share:g} % of them make",
    ],
)
def test_constants_are_as_documented(said: str) -> None:
    assert said in TEXT


def test_defaults_of_the_job_are_those_of_the_library() -> None:
    job = (ROOT / "docs" / "job.md").read_text(encoding="utf-8")
    refits, effective = (
        inspect.signature(f).parameters["n"].default for f in (updyn.bootstrap, updyn.sample)
    )
    assert f"| {refits} refits, {effective} effective draws |" in job


def test_every_source_is_cited() -> None:
    text, sources = TEXT.split("## Sources")
    text = re.sub(r"```.*?```", "", text)
    cited = {
        int(n) for group in re.findall(r"\[(\d+(?:, \d+)*)\]", text) for n in group.split(", ")
    }
    listed = {int(n) for n in re.findall(r"(?:^| )(\d+)\. [A-Z]\. ", sources)}
    assert cited == listed == set(range(1, 16))
