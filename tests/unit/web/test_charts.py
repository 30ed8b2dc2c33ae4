"""Charts as plain data, by value."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from updyn.settings import FIGURES
from updyn.style import CATEGORIES
from updyn.web.charts import SCALES, channel_map, frf_chart, level_chart, unused_bands
from updyn.web.settings import WEB_PAGE

FREQ = np.array([1.0, 2.0, 3.0, 4.0])
H = np.array([1.0, 10.0j, 0.0, np.nan])


def y_axis(chart: dict) -> dict:
    return chart["layout"]["yaxis"]


def test_few_measured_lines_are_points_and_many_are_a_curve():
    for n, mode in ((FIGURES.measured_points, "markers"), (FIGURES.measured_points + 1, "lines")):
        freq = np.linspace(1.0, 2.0, n)
        curves = {name: (freq, np.ones(n)) for name in ("measured", "start")}
        measured, start = frf_chart("receptance", curves)["data"]
        assert (measured["mode"], start["mode"]) == (mode, "lines")
        assert frf_chart("receptance", curves, small=True)["data"][0]["mode"] == "lines"


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
    given = frf_chart("accelerance", {"a": (FREQ, H)}, unit="(m/s²)/N")
    assert y_axis(given)["title"]["text"] == "|accelerance| in (m/s²)/N"
    assert (
        y_axis(frf_chart("ratio", {"a": (FREQ, H)}, scale="dB"))["title"]["text"] == "|ratio| (dB)"
    )


def test_curves_have_names_and_colours_by_role_and_order():
    names = ["measured", "start", "first", "repaired", "second"]
    chart = frf_chart("receptance", dict.fromkeys(names, (FREQ, H)))
    assert [trace["name"] for trace in chart["data"]] == names
    assert [trace["line"]["color"] for trace in chart["data"]] == [
        "@measured", "@before", f"@{CATEGORIES[1]}", "@third", f"@{CATEGORIES[3]}",
    ]  # fmt: skip
    assert {trace["showlegend"] for trace in chart["data"]} == {True}
    assert frf_chart("receptance", {})["data"] == []


def test_the_phase_is_a_panel_with_gaps_at_wraps():
    turning = np.exp(1j * np.radians([90.0, 170.0, -170.0, -90.0]))
    chart = frf_chart("receptance", {"measured": (FREQ, turning)}, phase=True)
    level, phase = chart["data"]
    assert (level["yaxis"], phase["yaxis"]) == ("y", "y2")
    assert phase["x"] == [1.0, 2.0, 3.0, 3.0, 4.0]
    assert phase["y"] == pytest.approx([90.0, 170.0, None, -170.0, -90.0])


def test_a_small_figure_has_neither_titles_nor_legend_and_fewer_points():
    freq = np.linspace(1.0, 100.0, 5 * WEB_PAGE.small_points)
    values = 1.0 / (1.0 - (freq / 50.0) ** 2 + 1e-3j)
    coherence = np.ones(len(freq))
    chart = frf_chart("receptance", {"a": (freq, values)}, small=True, coherence=coherence)
    layout = chart["layout"]
    assert {layout[axis]["title"]["text"] for axis in ("xaxis", "yaxis", "yaxis2")} == {""}
    assert not layout["showlegend"]
    assert len(chart["data"][0]["x"]["bdata"]) <= 4 * WEB_PAGE.small_points * 4 / 3 + 4
    assert chart["height"] < frf_chart("receptance", {"a": (freq, values)})["height"]


# -- maps
def test_a_map_has_the_highest_level_of_each_bin_of_each_channel(monkeypatch):
    freq = np.arange(1.0, 9.0)
    values = np.ones((8, 2), dtype=complex)
    values[3, 0], values[6, 1], values[:, 1] = 10.0, 100.0, np.where(freq == 7, 100j, 0.1)
    monkeypatch.setattr("updyn.web.charts.WEB_PAGE", dataclasses.replace(WEB_PAGE, map_lines=4))
    (found,) = channel_map(freq, values, ["a / b", "<c>"])["data"]
    assert found["x"] == [1.0, 3.0, 5.0, 7.0]
    assert found["y"] == ["a / b", "&lt;c&gt;"]
    assert np.array(found["z"]) == pytest.approx(
        np.array([[-40.0, -20.0, -40.0, -40.0], [-60.0, -60.0, -60.0, 0.0]])
    )


def test_a_map_of_a_model_has_its_differences_from_the_data(monkeypatch):
    freq = np.arange(1.0, 9.0)
    monkeypatch.setattr("updyn.web.charts.WEB_PAGE", dataclasses.replace(WEB_PAGE, map_lines=4))
    model = np.linspace(1.0, 8.0, 50), np.full((50, 1), 0.1)
    (found,) = channel_map(freq, np.ones((8, 1)), ["a"], model)["data"]
    assert np.array(found["z"]) == pytest.approx(np.full((1, 4), -20.0))
    assert (found["zmin"], found["zmax"]) == (-WEB_PAGE.map_difference, WEB_PAGE.map_difference)
    zero = channel_map(freq, np.zeros((8, 1)), ["a"])["data"][0]
    assert zero["z"] == [[None] * 4]


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


def test_the_peak_of_a_long_curve_is_drawn(monkeypatch):
    monkeypatch.setattr(
        "updyn.web.charts.WEB_PAGE", dataclasses.replace(WEB_PAGE, curve_points=200)
    )
    freq = np.linspace(1.0, 100.0, 20_001)
    values = 1.0 / (1.0 - (freq / 50.0) ** 2 + 1e-3j)
    (trace,) = frf_chart("receptance", {"a": (freq, values)})["data"]
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


# -- steps
def test_the_best_level_so_far_never_rises():
    points, best = level_chart({0: 6.0, 9: 0.5, 4: 9.0, 7: 2.0, 12: 0.8})["data"]
    assert (points["x"], points["y"]) == ([0, 4, 7, 9, 12], [6.0, 9.0, 2.0, 0.5, 0.8])
    assert best["y"] == [6.0, 6.0, 2.0, 0.5, 0.5]
    assert best["line"]["shape"] == "hv"
    json.dumps(level_chart({}), allow_nan=False)


@pytest.mark.parametrize(("steps", "every"), [((0, 1, 2), 1), ((0, 22, 36), None)])
def test_each_step_has_a_tick_only_if_they_are_few(steps, every):
    layout = level_chart(dict.fromkeys(steps, 0.5))["layout"]
    assert layout["xaxis"].get("dtick") == every
    assert layout["yaxis"]["exponentformat"] == "none"  # 0.5 dB, not 5x10^-1
