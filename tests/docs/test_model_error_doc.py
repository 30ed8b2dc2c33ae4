"""docs/model-error.md: its example is what comes out, its names are those of the library."""

from __future__ import annotations

import re
from dataclasses import fields

import numpy as np
import pytest

import updyn
from pages import ROOT, blocks
from updyn.model import Model
from updyn.updating.judge.adequacy import OUTCOMES, Misfit, Suspect
from updyn.updating.judge.settings import RESIDUAL_TEST

PAGE = ROOT / "docs" / "model-error.md"
TEXT = PAGE.read_text(encoding="utf-8")
WORDS = " ".join(TEXT.split())


@pytest.fixture(scope="module")
def result(chain12_true: Model, add_noise):
    sensors = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
    exact = updyn.response(chain12_true, np.linspace(2.0, 22.0, 60), sensors, sensors[:2])
    data = add_noise(exact, np.random.default_rng(7), 0.01)
    start = chain12_true.scaled({"part3": {"stiffness": 0.9}})
    others = ["part1", "part2", "part4"]
    unknowns = updyn.parameters(start, stiffness=others, loss_factor=others)
    return updyn.update(start, data, unknowns, starts=0, noise={"relative": 0.01})


def test_the_verdict_on_the_page_is_that_of_the_example(result) -> None:
    shown = next(b.text for b in blocks(PAGE) if b.language == "text")
    assert " ".join(shown.split()) == result.adequacy.verdict
    assert "part 3 of the chain of the tests held 10 % too soft while" in WORDS


def test_what_python_shows_is_there(result) -> None:
    code = next(b.text for b in blocks(PAGE) if b.language == "python")
    for name in re.findall(r"result\.adequacy\.(\w+)", code):
        assert hasattr(result.adequacy, name)
    assert re.findall(r'"(\w+)"', code) == list(OUTCOMES)


def test_every_outcome_is_explained() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE)
    assert tuple(rows) == OUTCOMES
    assert f"at most {100 * RESIDUAL_TEST.alarm_level:g} % of runs" in WORDS


def test_what_a_suspect_has_is_explained() -> None:
    for field in fields(Suspect):
        if field.name not in ("group", "quantity"):
            assert f"`{field.name}`" in TEXT, field.name
    assert {"misfit", "correlation_length", "near"} <= {f.name for f in fields(Misfit)}
