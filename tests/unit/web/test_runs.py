"""Runs side by side: what a record states is shown, and nothing else."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from updyn.report.changes import changes_of_fits
from updyn.updating.judge.claim import PARTS
from updyn.web.project import RunFolder
from updyn.web.runs import (
    RunOutcome,
    compare_runs,
    describe_outcome,
    find_level_error,
    read_badge,
    read_changes,
)


def unknown(name, value, std, start=1.0, **more):
    group, quantity = name.split(".")
    bounds = {"lower": 0.1, "upper": 10.0, "drives": []}
    return {"name": name, "group": group, "quantity": quantity, "start": start, **bounds,
            "value": value, "std": std, **more}  # fmt: skip


RECORD = {
    "status": "converged",
    "message": "All is well.",
    "method": "output-error",
    "iterations": 12,
    "trust": {"determined": {"holds": True, "why": "."}, "validated": {"holds": None, "why": "."}},
    "correlation": {
        "before": {"frac_median": 0.5, "db_error_median": 6.0},
        "after": {"frac_median": 0.98765432, "csac_mean": 0.5, "db_error_median": 0.25},
    },
    "parameters": [
        unknown("shaft.stiffness", 1.23456789, 0.012345),
        unknown("shaft.mass", 2.0, None),
    ],
}


def rows(*records, folder=Path("none")):
    runs = [RunFolder(folder / str(n), record, 0.0) for n, record in enumerate(records)]
    return {row.name: row for row in compare_runs(runs)}


def test_a_record_by_its_rows():
    found = rows(RECORD)
    cells = {name: row.cells for name, row in found.items()}
    assert cells == {
        "status": ["converged"],
        "method": ["output-error"],
        "steps": ["12"],
        "determined": ["yes"],
        "validated": ["not known"],
        "level error, median (dB)": ["6 → 0.25"],
        "FRAC, median": ["0.5 → 0.9877"],
        "shaft.stiffness": ["1.2346 ± 0.012, +23.5 %"],
        "shaft.mass": ["2 (not determined), +100 %"],
    }
    assert not any(row.differs for row in found.values())
    assert find_level_error(RECORD) == 0.25
    assert math.isnan(find_level_error({}))


def test_what_one_run_lacks_stays_empty_and_differs():
    other = {"status": "failed", "parameters": [unknown("gear.mass", 1.5, 0.1)]}
    found = rows(RECORD, other)
    assert found["status"].cells == ["converged", "failed"]
    assert found["gear.mass"].cells == ["", "1.5 ± 0.1, +50 %"]
    assert found["status"].differs
    assert found["gear.mass"].differs


@pytest.mark.parametrize(("value", "differs"), [(1.04, False), (1.06, True)])
def test_unknowns_differ_if_their_intervals_have_no_common_value(value, differs):
    """Intervals of +-1.96 x 0.0125 in the logarithm have a common value up to a factor of 1.05."""
    first, second = (
        {"status": "", "parameters": [unknown("a.mass", x, 0.0125 * x)]} for x in (1.0, value)
    )
    assert rows(first, second)["a.mass"].differs is differs


def test_jobs_differ_by_their_keys(tmp_path):
    for number, text in enumerate(
        ("[test]\nband = [1, 2]\nfile = 'a'", "[test]\nfile = 'a'\n[[parameter]]\nx = 1")
    ):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / "job.toml").write_text(text, encoding="utf-8")
    found = {
        row.name: row.cells
        for row in rows({}, {}, folder=tmp_path).values()
        if row.section == "job"
    }
    assert found == {"test.band": ["[1, 2]", ""], "parameter[1].x": ["", "1"]}


def test_changes_are_those_of_the_record():
    linked = unknown(
        "all.scale", 1.5, 0.01, drives=[{"group": "a", "quantity": "mass", "power": 2.0}]
    )
    bound = unknown("a.mass", 10.0, 0.1, at_bound=True)
    record = {**RECORD, "parameters": [*RECORD["parameters"], linked, bound]}
    found = read_changes(record)
    assert [(one.parameter.name, one.value, one.outcome) for one in found] == [
        ("shaft.stiffness", 1.23456789, "changed"),
        ("shaft.mass", 2.0, "undetermined"),
        ("all.scale", 1.5, "changed"),
        ("a.mass", 10.0, "bound"),
    ]
    low, high = found[0].span
    assert low * high == pytest.approx(1.23456789**2)


def test_parameters_of_elements_are_among_the_changes():
    gap = unknown("mesh.gap", 1.1e-4, 1e-6, start=2e-4, of_element=True)
    gap |= {"lower": 1e-5, "upper": 1e-2}
    (found,) = read_changes({"parameters": [gap]})
    assert (found.parameter.name, found.parameter.of_element) == ("mesh.gap", True)
    assert found.outcome == "changed"


def test_changes_of_several_runs_have_a_row_for_each_unknown():
    other = {
        **RECORD,
        "parameters": [unknown("shaft.mass", 0.5, 0.01), unknown("gear.mass", 1.5, 0.1)],
    }
    figure = changes_of_fits({"first": read_changes(RECORD), "second": read_changes(other)})
    assert figure["layout"]["yaxis"]["ticktext"] == [
        "shaft: stiffness",
        "shaft: mass",
        "gear: mass",
    ]
    places = {
        trace["name"]: dict(zip(trace["y"], trace["x"], strict=True))
        for trace in figure["data"]
        if trace.get("name") in ("first", "second")
    }
    assert places["first"] == pytest.approx({-0.2: 1.23456789, 0.8: 2.0})
    assert places["second"] == pytest.approx({1.2: 0.5, 2.2: 1.5})
    assert changes_of_fits({"none": []}) is None


def test_a_value_that_is_not_known():
    """A run that failed writes none."""
    unknowns = [unknown("shaft.mass", None, None), {"name": "a.mass"}]
    record = {"status": "failed", "parameters": unknowns}
    found = rows(record)
    assert found["shaft.mass"].cells == found["a.mass"].cells == ["not known"]
    assert read_changes(record) == []


@pytest.mark.parametrize(
    "record", [{}, {"parameters": None}, {"trust": 3, "correlation": [], "status": None}]
)
def test_a_record_without_anything(record):
    assert set(rows(record)) == {"status", "method", "steps"}
    assert read_changes(record) == []


def test_an_outcome_is_two_sentences_with_its_next_step():
    record = {
        "status": "converged",
        "message": "The fit converged. A mode at 1.5 Hz is not in the model. Remark.",
        "remedy": "Check the shape.\nFree other groups.",
    }
    found = describe_outcome(record)
    assert found.statement == "Converged. The fit converged. A mode at 1.5 Hz is not in the model."
    assert found.next_step == "Check the shape."
    assert found.remarks == ["Remark.", "Free other groups."]
    assert describe_outcome({"status": "failed"}) == RunOutcome("Failed.", "", [])

    parts = {part: {"holds": True, "asked": True} for part in PARTS}
    for changed, phrase in (
        ({}, "Usable"),
        ({"validated": {"holds": None, "asked": False}}, "Fits, not validated"),
        ({"plausible": {"holds": False, "asked": True}}, "Not credible"),
        ({"resembles": {"holds": False, "asked": True}}, "Does not resemble the test"),
    ):
        assert read_badge({"status": "converged", "trust": parts | changed}).phrase == phrase
