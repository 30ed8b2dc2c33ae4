"""The figure of the changes: places, ratios, outcomes and marks, by value."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from pages_read import Page, values
from report_case import largest, realistic, smallest
from updyn.report.changes import changes_figure, is_significant, largest_changes
from updyn.report.page import render
from updyn.report.settings import REPORT_LIST
from updyn.updating.problem.parameters import Parameter, ParameterSet


def by_name(figure):
    return {trace["name"]: trace for trace in figure["data"] if "name" in trace}


CHANGED = "changed: the 95 % interval excludes the start"
INSIGNIFICANT = "not significant: the 95 % interval includes the start"


def test_unknowns_stand_by_quantity_at_their_ratio_to_the_start():
    result = realistic()
    figure = changes_figure(result)
    axis = figure["layout"]["yaxis"]
    names = dict(zip(axis["tickvals"], axis["ticktext"], strict=True))
    assert [names[i] for i in sorted(names)] == [
        *("<b>stiffness</b>", "bay 2", "bay 5", "bay 8"),
        *("<b>mass</b>", "bay 5", "bay 11"),
        *("<b>loss factor</b>", "bay 2", "bay 11"),
    ]
    traces = by_name(figure)
    at = {
        name: dict(zip(trace["y"], values(trace["x"]), strict=True))
        for name, trace in traces.items()
    }
    places = {name: place for place, name in names.items()}
    assert at["ended at a bound"] == pytest.approx({places["bay 8"]: 0.6})
    assert sorted(at["not determined by the data"].values()) == pytest.approx([1.1, 1.3])
    assert sorted(at[CHANGED].values()) == pytest.approx([0.72, 1.2, 2.2, 3.0])
    assert INSIGNIFICANT not in traces
    # The interval of a factor is symmetric in its logarithm.
    bars = traces[CHANGED]["error_x"]
    first = int(np.argmin(values(traces[CHANGED]["x"])))
    low, high = 0.72 - bars["arrayminus"][first], 0.72 + bars["array"][first]
    assert low * high == pytest.approx(0.72**2)
    assert math.log(high / 0.72) == pytest.approx(1.959964 * 0.72 * 0.004 / 0.72)
    assert figure["layout"]["yaxis2"]["ticktext"].count("−28 %") == 1


def test_a_change_within_its_interval_is_not_significant():
    result = smallest()
    (p,) = result.parameters
    for std, significant in ((0.05, True), (0.12, False), (np.inf, False)):
        found = dataclasses.replace(result, std={p.name: std})
        assert is_significant(found, p) is significant
    traces = by_name(changes_figure(dataclasses.replace(result, std={p.name: 0.12})))
    assert CHANGED not in traces
    assert traces[INSIGNIFICANT]["marker"]["symbol"] == "circle-open"


def test_bounds_are_marked_where_they_are_in_view():
    bounds = by_name(changes_figure(realistic()))["bound"]
    assert 0.6 in bounds["x"]  # the lower bound at which the stiffness of bay 8 ended
    assert not any(x > 3.5 for x in bounds["x"])


def of_values(ends, std):
    """A result whose loss factors started at 0.1 and came out at `ends`."""
    items = [Parameter(f"g{i}", "loss_factor", 0.1, 0.0, 100.0) for i in range(len(ends))]
    chosen = ParameterSet(tuple(items))
    return dataclasses.replace(
        smallest(),
        parameters=chosen,
        values=dict(zip(chosen.names, ends, strict=True)),
        std=dict.fromkeys(chosen.names, std),
    )


@pytest.mark.parametrize(
    ("ends", "marked"),
    [
        ([0.1001, 0.0999], {"0 %", "+0.1 %", "−0.1 %"}),
        ([0.05, 0.12], {"0 %", "−50 %", "+10 %"}),
        ([0.3, 3.0], {"0 %", "+100 %", "×10"}),
    ],
)
def test_the_axis_is_marked_at_round_changes(ends, marked):
    axis = changes_figure(of_values(ends, 1e-6))["layout"]["xaxis"]
    assert marked <= set(axis["ticktext"])
    assert 3 <= len(axis["ticktext"]) <= 14
    shown = 10.0 ** np.array(axis["range"])
    assert all(shown[0] <= tick <= shown[1] for tick in axis["tickvals"])
    assert len(set(axis["ticktext"])) == len(axis["tickvals"])


def test_the_largest_changes_are_marked_on_both_sides():
    axis = largest_changes(of_values([0.0, 1.0], 1e-6))["layout"]["xaxis"]
    assert axis["ticktext"] == ["−90 %", "0 %", "×10"]
    assert axis["tickvals"] == pytest.approx([0.1, 1.0, 10.0])


def test_a_value_that_fell_to_zero_stands_at_the_end_of_the_axis():
    figure = changes_figure(of_values([0.0, 0.2], 0.01))
    shown = 10.0 ** np.array(figure["layout"]["xaxis"]["range"])
    x = values(by_name(figure)[CHANGED]["x"])
    assert x[0] == pytest.approx(shown[0])
    assert "−100 %" in figure["layout"]["yaxis2"]["ticktext"]


def test_what_starts_at_zero_is_told_in_words():
    result = smallest()
    items = (
        Parameter("bay 1", "loss_factor", 0.0, 0.0, 1.0),
        Parameter("bay 2", "loss_factor", 0.0, 0.0, 1.0),
    )
    chosen = ParameterSet(items)
    found = dataclasses.replace(
        result,
        parameters=chosen,
        values=dict(zip(chosen.names, (0.02, 1e-9), strict=True)),
        std=dict.fromkeys(chosen.names, 0.001),
        covariance=1e-6 * np.eye(2),
    )
    assert changes_figure(found) is None
    words = Page(render(found)).words
    assert "loss factor of bay 1 now 0.02 (95 % interval 0.01804 to 0.02196)." in words
    assert "not significantly above it: loss factor of bay 2." in words


def test_of_many_unknowns_those_that_changed_most_are_shown():
    result = largest(n_responses=60, n_lines=60)
    shown = len(result.parameters) - REPORT_LIST.changed_unknowns
    figure = changes_figure(result)
    assert len(figure["layout"]["yaxis2"]["tickvals"]) == REPORT_LIST.changed_unknowns
    assert f"The {shown} unknowns that changed least" in Page(render(result)).words
