"""Runs side by side: what stands in a record is shown, and nothing else is made up."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from updyn.web.pages.results import compare_runs
from updyn.web.project import RunFolder

RECORD = {
    "status": "converged",
    "message": "All is well.",
    "iterations": 12,
    "trust": {"determined": {"holds": True, "why": "."}, "validated": {"holds": None, "why": "."}},
    "correlation": {"after": {"frac_median": 0.98765432, "csac_mean": 0.5}},
    "parameters": [
        {"name": "shaft.stiffness", "value": 1.23456789, "std": 0.012345},
        {"name": "shaft.mass", "value": 2.0, "std": None},
    ],
}


def table(**records):
    runs = {
        name.replace("_", "."): RunFolder(Path(name), record, 0.0)
        for name, record in records.items()
    }
    columns, rows = compare_runs(runs)
    labels = {column["field"]: column["label"] for column in columns}
    return {
        row["what"]: {labels[key]: text for key, text in row.items() if key != "what"}
        for row in rows
    }


def test_a_record_by_its_rows():
    found = table(one=RECORD)
    assert found["status"] == {"one": "converged"}
    assert found["steps"] == {"one": "12"}
    assert found["determined"] == {"one": "yes"}
    assert found["validated"] == {"one": "not known"}
    assert found["FRAC after, median"] == {"one": "0.9877"}
    assert found["shaft.stiffness"] == {"one": "1.2346 ± 0.012"}
    assert found["shaft.mass"] == {"one": "2"}


def test_what_one_run_lacks_stays_empty():
    other = {"status": "failed", "parameters": [{"name": "gear.mass", "value": 1.5, "std": 0.1}]}
    found = table(a=RECORD, b_dot=other)
    assert found["status"] == {"a": "converged", "b.dot": "failed"}
    assert found["gear.mass"] == {"b.dot": "1.5 ± 0.1"}
    assert found["shaft.mass"] == {"a": "2"}


def test_a_value_that_is_not_known():
    """A run that failed writes none."""
    unknowns = [{"name": "shaft.mass", "value": None, "std": None}, {"name": "a.mass"}]
    found = table(one={"status": "failed", "parameters": unknowns})
    assert found["shaft.mass"] == found["a.mass"] == {"one": "not known"}


@pytest.mark.parametrize(
    "record", [{}, {"parameters": None}, {"trust": 3, "correlation": [], "status": None}]
)
def test_a_record_without_anything(record):
    assert set(table(one=record)) == {"status", "message", "steps"}
