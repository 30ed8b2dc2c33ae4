"""Limits of what commands print: a case on either side of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.cli import describe, frf, outcome, sections, written
from updyn.dofs import DofSet
from updyn.model import Group, Model


def test_a_line_lists_eight_items():
    names = [f"{k}:X" for k in range(1, 10)]
    assert sections._join_names(names[:8]) == ", ".join(names[:8])
    assert sections._join_names(names) == ", ".join(names[:8]) + " and 1 more"
    assert describe._format_dofs(DofSet(names[:8])) == ", ".join(names[:8])
    assert describe._format_dofs(DofSet(names)) == ", ".join(names[:8]) + ", ... 9:X"
    assert written._format_keys(names[:8]).endswith("'8:X'")
    assert written._format_keys(names).endswith("'8:X', ...")


def test_natural_frequencies_of_models():
    n = 9
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    model = Model.from_groups({"a": Group(K, np.eye(n))}, [f"{k}:X" for k in range(1, n + 1)])
    assert describe._natural_frequencies(model).count(",") == 7
    for n_dofs, refused in ((20_000, False), (20_001, True)):
        try:
            text = describe._natural_frequencies(SimpleNamespace(n_dofs=n_dofs))
        except AttributeError:  # computed
            text = ""
        assert ("not computed for more than 20000" in text) is refused


@pytest.mark.parametrize("count", [20, 21])
def test_a_table_of_coherences(count):
    coherence = np.full((10, count, 1), 0.95)
    coherence[:3, 0] = 0.89
    coherence[3, 0] = 0.91
    given = updyn.FRF(
        np.arange(1.0, 11.0),
        np.ones((10, count, 1)),
        [f"{k}:X" for k in range(1, count + 1)],
        ["1:X"],
        "receptance",
        coherence=coherence,
    )
    text = frf._coherence_table(given)
    assert "lines below 0.9" in text
    assert "30.0 %" in text
    assert ("1 more pairs" in text) == (count == 21)


def test_a_file_is_identified_by_its_start(tmp_path):
    path = tmp_path / "file"
    path.write_text("x" * 5000)
    assert len(written._read_start(path)) == 4096


@pytest.mark.parametrize(("count", "hint"), [(30, False), (31, True)])
def test_more_than_thirty_groups_may_be_merged(count, hint):
    groups = {f"part{k}": Group(np.eye(1), np.eye(1)) for k in range(count)}
    lines = describe._describe_merging(Model.from_groups(groups, ["1:X"]))
    assert any("merge them" in line for line in lines) is hint


@pytest.mark.parametrize(("closing", "lines", "changes"), [(12, 20, 5), (13, 20, 4), (1, 9, 5)])
def test_an_outcome_has_twenty_lines_and_five_changes(monkeypatch, closing, lines, changes):
    """A verdict, changes and closing lines in three blocks."""
    monkeypatch.setattr(outcome, "_describe_verdict", lambda *_: ["verdict"])
    monkeypatch.setattr(outcome, "describe_agreement", lambda *_: [])
    monkeypatch.setattr(outcome, "_format_next_step", lambda *_: [])
    monkeypatch.setattr(outcome, "_format_changes", lambda _, rows, width: "\n".join("c" * rows))
    text = outcome.describe_outcome(None, ["closing"] * closing, None)
    assert len(text.splitlines()) == lines
    assert text.splitlines().count("c") == changes


@pytest.mark.parametrize(("level", "text"), [(0.9e-4, "<0.0001"), (1.1e-4, "0.00011")])
def test_a_level_difference_of_rounding_is_a_limit(level, text):
    assert outcome._format_figure("db_p95", level).startswith(text)
