"""Charts as plain data, by value."""

from __future__ import annotations

import json

import numpy as np
import pytest

from updyn.style import CATEGORIES
from updyn.web.charts import SCALES, cost_chart, frf_chart, parameter_chart, unused_bands

FREQ = np.array([1.0, 2.0, 3.0, 4.0])
H = np.array([1.0, 10.0j, 0.0, np.nan])


def y_axis(chart: dict) -> dict:
    return chart["layout"]["yaxis"]


# -- curves
@pytest.mark.parametrize(
    ("scale", "expected", "kind"),
    [
        ("linear", [1.0, 10.0, 0.0, None], None),
        ("log", [1.0, 10.0, None, None], "log"),
        ("dB", [0.0, 20.0, None, None], None),
    ],
)
def test_magnitudes_by_scale_with_gaps_where_there_is_none(scale, expected, kind):
    chart = frf_chart("accelerance", {"measured": (FREQ, H)}, scale=scale)
    assert [(trace["x"], trace["y"]) for trace in chart["data"]] == [(FREQ.tolist(), expected)]
    assert y_axis(chart).get("type") == kind
    unit = "dB re 1 m/s²/N" if scale == "dB" else "m/s²/N"
    assert y_axis(chart)["title"]["text"] == f"|accelerance| ({unit})"
    low, high = chart["layout"]["xaxis"]["range"]
    assert low < FREQ[0] < FREQ[-1] < high
    assert scale in SCALES
    json.dumps(chart, allow_nan=False)  # what goes to the browser


def test_quantities_without_a_unit_have_none():
    assert y_axis(frf_chart("ratio", {"a": (FREQ, H)}))["title"]["text"] == "|ratio|"
    assert (
        y_axis(frf_chart("ratio", {"a": (FREQ, H)}, scale="dB"))["title"]["text"] == "|ratio| (dB)"
    )


def test_few_curves_have_names_and_many_do_not():
    few = frf_chart("receptance", {str(n): (FREQ, H) for n in range(1 + len(CATEGORIES))})
    many = frf_chart("receptance", {str(n): (FREQ, H) for n in range(2 + len(CATEGORIES))})
    assert {trace["showlegend"] for trace in few["data"]} == {True}
    assert {trace["showlegend"] for trace in many["data"]} == {False}
    assert [trace["name"] for trace in few["data"]] == [str(n) for n in range(1 + len(CATEGORIES))]
    colours = [trace["line"]["color"] for trace in few["data"]]
    assert colours == ["@measured", *(f"@{role}" for role in CATEGORIES)]
    assert frf_chart("receptance", {})["data"] == []


def test_bands_are_shaded():
    chart = frf_chart("receptance", {"a": (FREQ, H)}, band=(1.5, 3.5), excluded=[(2.0, 2.5)])
    shades = [(s["x0"], s["x1"], s["fillcolor"]) for s in chart["layout"]["shapes"]]
    assert shades == [(2.0, 2.5, "@held-band"), (1.5, 3.5, "@fit-band")]
    assert frf_chart("receptance", {"a": (FREQ, H)})["layout"]["shapes"] == []


def test_a_band_is_dragged_only_where_it_can_be_picked():
    pickable = frf_chart("receptance", {"a": (FREQ, H)}, pickable=True)["layout"]
    assert [pickable[key] for key in ("dragmode", "selectdirection", "clickanywhere")] == [
        "select", "h", True,
    ]  # fmt: skip
    assert "dragmode" not in frf_chart("receptance", {"a": (FREQ, H)})["layout"]


def test_the_peak_of_a_long_curve_is_drawn():
    freq = np.linspace(1.0, 100.0, 20_001)
    values = 1.0 / (1.0 - (freq / 50.0) ** 2 + 1e-3j)
    (trace,) = frf_chart("receptance", {"a": (freq, values)}, points=200)["data"]
    assert len(trace["x"]) == len(trace["y"]) <= 200
    assert max(trace["y"]) == pytest.approx(1e3, rel=1e-4)


def test_coherence_is_a_panel_with_gaps_where_it_is_not_known():
    known = np.array([1.0, 0.5, np.nan, 0.0], dtype=np.float32)
    chart = frf_chart("receptance", {"a": (FREQ, H)}, coherence=known)
    magnitude, coherence = chart["data"]
    assert (magnitude["yaxis"], coherence["yaxis"]) == ("y", "y2")
    assert (coherence["x"], coherence["y"]) == (FREQ.tolist(), [1.0, 0.5, None, 0.0])
    axis = chart["layout"]["yaxis2"]
    assert axis["range"][0] == 0
    assert axis["title"]["text"] == "coherence (1)"
    json.dumps(chart, allow_nan=False)


# -- lines that are not used
@pytest.mark.parametrize(
    ("used", "bands"),
    [
        ("1111111", []),
        ("0111110", []),
        ("1101011", [(25.0, 35.0), (45.0, 55.0)]),
        ("1100011", [(25.0, 55.0)]),
        ("0010100", [(35.0, 45.0)]),
        ("0000000", []),
        ("0001000", []),
    ],
)
def test_bands_of_lines_that_are_not_used(used, bands):
    freq = np.arange(1, 8) * 10.0
    assert unused_bands(freq, np.array([c == "1" for c in used])) == bands


# -- steps and values
def test_steps_of_each_stage_are_a_curve_at_their_place_among_all():
    steps = [
        {"stage": "rough", "cost": 9.0}, {"stage": "rough", "cost": 4.0}, {"stage": "fine", "cost": 3.0},
        {"stage": "fine", "cost": None}, {"stage": "fine", "cost": 0.0}, {"stage": "fine", "cost": 1.0},
    ]  # fmt: skip
    chart = cost_chart(steps)
    assert [(trace["name"], trace["x"], trace["y"]) for trace in chart["data"]] == [
        ("rough", [0, 1], [9.0, 4.0]), ("fine", [2, 5], [3.0, 1.0]),
    ]  # fmt: skip
    assert y_axis(chart)["type"] == "log"
    assert cost_chart([])["data"] == []
    many = cost_chart([{"stage": str(n), "cost": 1.0} for n in range(3 * len(CATEGORIES))])
    assert len(many["data"]) == 3 * len(CATEGORIES)
    assert {trace["mode"] for trace in many["data"]} == {"lines+markers"}


def test_values_beside_their_start():
    chart = parameter_chart(
        {"a": 2.0, "b": 0.0, "c": -4.0, "d": 1.0}, {"a": 3.0, "b": 1.0, "c": -1.0}
    )
    assert y_axis(chart)["ticktext"] == ["a", "c"]
    (bars,) = chart["data"]
    assert (bars["x"], bars["y"]) == ([1.5, 0.25], [0, 1])
