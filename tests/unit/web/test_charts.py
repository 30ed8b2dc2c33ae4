"""Charts as plain data, by value."""

from __future__ import annotations

import json

import numpy as np
import pytest

from updyn.style import CATEGORIES
from updyn.web.charts import (
    SCALES,
    coherence_chart,
    cost_chart,
    frf_chart,
    parameter_chart,
    thin_indices,
    unused_bands,
)

FREQ = np.array([1.0, 2.0, 3.0, 4.0])
H = np.array([1.0, 10.0j, 0.0, np.nan])


def data(chart: dict, number: int = 0) -> list:
    return chart["series"][number]["data"]


# -- curves
@pytest.mark.parametrize(
    ("scale", "expected", "kind"),
    [
        ("linear", [1.0, 10.0, 0.0, None], "value"),
        ("log", [1.0, 10.0, None, None], "log"),
        ("dB", [0.0, 20.0, None, None], "value"),
    ],
)
def test_magnitudes_by_scale_with_gaps_where_there_is_none(scale, expected, kind):
    chart = frf_chart("accelerance", {"measured": (FREQ, H)}, scale=scale)
    assert data(chart) == [list(pair) for pair in zip(FREQ.tolist(), expected, strict=True)]
    assert chart["yAxis"]["type"] == kind
    unit = "dB re 1 m/s²/N" if scale == "dB" else "m/s²/N"
    assert chart["yAxis"]["name"] == f"|accelerance| ({unit})"
    assert scale in SCALES
    json.dumps(chart, allow_nan=False)  # what goes to the browser


def test_quantities_without_a_unit_have_none():
    assert frf_chart("ratio", {"a": (FREQ, H)})["yAxis"]["name"] == "|ratio|"
    assert frf_chart("ratio", {"a": (FREQ, H)}, scale="dB")["yAxis"]["name"] == "|ratio| (dB)"


def test_few_curves_have_names_and_many_do_not():
    few = frf_chart("receptance", {str(n): (FREQ, H) for n in range(1 + len(CATEGORIES))})
    many = frf_chart("receptance", {str(n): (FREQ, H) for n in range(2 + len(CATEGORIES))})
    assert [few["legend"]["show"], many["legend"]["show"]] == [True, False]
    assert [s["name"] for s in few["series"]] == [str(n) for n in range(1 + len(CATEGORIES))]
    colours = [str(s["lineStyle"]) for s in few["series"]]
    assert len(set(colours)) == len(colours)
    assert frf_chart("receptance", {})["series"] == []


def test_bands_are_shaded_on_the_first_curve():
    chart = frf_chart(
        "receptance", {"a": (FREQ, H), "b": (FREQ, H)}, band=(1.5, 3.5), excluded=[(2.0, 2.5)]
    )
    areas = chart["series"][0]["markArea"]["data"]
    assert [(low["xAxis"], high["xAxis"]) for low, high in areas] == [(2.0, 2.5), (1.5, 3.5)]
    assert "markArea" not in chart["series"][1]
    assert "markArea" not in frf_chart("receptance", {"a": (FREQ, H)})["series"][0]


# -- thinning
@pytest.mark.parametrize("n", [2, 3, 10, 100, 999])
@pytest.mark.parametrize("m", [1000, 1001, 4096])
def test_a_thinned_curve_has_the_extremes_of_each_part(m, n):
    values = np.random.default_rng(m + n).normal(size=m)
    values[[m // 3, m // 2]] = 50.0, -50.0
    at = thin_indices(values, n)
    assert len(at) <= n
    assert np.all(np.diff(at) > 0)
    assert {m // 3, m // 2} <= set(at.tolist())
    # A second method: part by part, the smallest and the largest.
    parts = np.split(np.arange(m), np.linspace(0, m, max(1, n // 2) + 1).astype(int)[1:-1])
    for part in parts:
        inside = values[at[(at >= part[0]) & (at <= part[-1])]]
        assert (inside.min(), inside.max()) == (values[part].min(), values[part].max())


@pytest.mark.parametrize("m", [0, 1, 5])
def test_a_short_curve_is_not_thinned(m):
    assert thin_indices(np.arange(float(m)), 5).tolist() == list(range(m))


def test_one_point_at_most_and_values_that_are_no_numbers():
    assert len(thin_indices(np.arange(10.0), 1)) <= 2
    values = np.full(100, np.nan)
    values[57] = 3.0
    values[91] = -3.0
    at = thin_indices(values, 10)
    assert {57, 91} <= set(at.tolist())
    assert np.all(np.diff(at) > 0)


def test_the_peak_of_a_long_curve_is_drawn():
    freq = np.linspace(1.0, 100.0, 20_001)
    values = 1.0 / (1.0 - (freq / 50.0) ** 2 + 1e-3j)
    rows = data(frf_chart("receptance", {"a": (freq, values)}, points=200))
    assert len(rows) <= 200
    assert max(m for _, m in rows) == pytest.approx(1e3, rel=1e-4)


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
    assert [(s["name"], s["data"]) for s in chart["series"]] == [
        ("rough", [[0, 9.0], [1, 4.0]]), ("fine", [[2, 3.0], [5, 1.0]]),
    ]  # fmt: skip
    assert chart["yAxis"]["type"] == "log"
    assert cost_chart([])["series"] == []
    many = cost_chart([{"stage": str(n), "cost": 1.0} for n in range(3 * len(CATEGORIES))])
    assert len(many["series"]) == 3 * len(CATEGORIES)


def test_values_beside_their_start():
    chart = parameter_chart(
        {"a": 2.0, "b": 0.0, "c": -4.0, "d": 1.0}, {"a": 3.0, "b": 1.0, "c": -1.0}
    )
    assert chart["yAxis"]["data"] == ["a", "c"]
    assert data(chart) == [1.5, 0.25]


def test_coherence_has_gaps_where_it_is_not_known():
    chart = coherence_chart(FREQ, np.array([1.0, 0.5, np.nan, 0.0], dtype=np.float32))
    assert data(chart) == [[1.0, 1.0], [2.0, 0.5], [3.0, None], [4.0, 0.0]]
    assert (chart["yAxis"]["min"], chart["yAxis"]["max"]) == (0, 1)
    json.dumps(chart, allow_nan=False)
