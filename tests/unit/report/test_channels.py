"""The worst and the median channel: which they are, and what is drawn of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from pages_read import values
from report_case import realistic, smallest
from updyn.demos import chain
from updyn.report.channels import channel_curves, is_mostly_noise, worst_and_median
from updyn.report.data import gather
from updyn.report.overlay import ALL_CHANNELS
from updyn.report.page import render
from updyn.report.section import PageContent


@pytest.fixture(scope="module")
def data():
    return gather(realistic())


def test_a_channel_of_the_wrong_sign_is_the_worst(data):
    """FRAC does not see it."""
    result = realistic()
    values_ = result.frf.values.copy()
    values_[:, 3, 1] *= -1.0
    found = gather(
        dataclasses.replace(result, data=dataclasses.replace(result.frf, values=values_))
    )
    assert worst_and_median(found)["worst"] == (3, 1)
    assert found.frac_after[3, 1] == pytest.approx(data.frac_after[3, 1])
    assert found.residual_after[3, 1] == pytest.approx(2.0, abs=0.01)


def test_a_channel_of_noise_is_not_the_worst():
    """The noise of each channel follows from the misfits; what a perfect fit leaves is no error."""
    model, seed = chain.build(), np.random.default_rng(0)
    true = model.scaled({"part1": {"stiffness": 1.2}})
    clean = updyn.response(true, np.linspace(1.0, 15.0, 200), ["2:X", "9:X"], ["12:X"])
    level = np.sqrt(np.mean(np.abs(clean.values) ** 2, axis=0))
    std = np.broadcast_to(level * [[3.0], [0.02]], clean.values.shape)
    draw = seed.standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
    data = dataclasses.replace(
        clean, values=clean.values + std * (draw[0] + 1j * draw[1]), variance=std**2
    )
    unknowns = updyn.parameters(model, stiffness=["part1"])
    found = gather(updyn.update(model, data, unknowns, starts=0))
    expected = std[0] / np.sqrt(np.mean(np.abs(data.values) ** 2, axis=0))
    np.testing.assert_allclose(found.noise, expected, rtol=0.05)
    assert found.residual_after[0, 0] > 0.9
    assert worst_and_median(found) == {"worst": (1, 0), "other": (0, 0)}
    assert is_mostly_noise(found, 0, 0)
    # A model error that leaves much more than noise there counts.
    wrong = dataclasses.replace(found, residual_after=np.array([[2.5], [0.02]]))
    assert worst_and_median(wrong)["worst"] == (0, 0)


@pytest.mark.parametrize(
    ("noise", "residual", "expected"),
    [(0.51, 1.0, True), (0.49, 0.5, False), (0.6, 1.1, True), (0.6, 1.3, False)],
)
def test_noise_is_most_of_a_channel_from_a_half_of_level_and_residual(noise, residual, expected):
    two = dataclasses.replace(
        gather(smallest()), noise=np.array([[noise]]), residual_after=np.array([[residual]])
    )
    assert is_mostly_noise(two, 0, 0) == expected


def test_half_of_the_channels_agree_better_than_the_median_one(data):
    chosen = worst_and_median(data)
    residual = data.residual_after
    assert residual[chosen["worst"]] == residual.max()
    assert np.sum(residual < residual[chosen["median"]]) in (4, 5)


def test_channels_measured_as_zero_are_left_out(data):
    residual = data.residual_after.copy()
    residual[0] = np.inf
    chosen = worst_and_median(dataclasses.replace(data, residual_after=residual))
    assert 0 not in (chosen["worst"][0], chosen["median"][0])
    nothing = dataclasses.replace(data, residual_after=None, residual_before=None)
    assert worst_and_median(nothing) == {}


def test_few_channels():
    one = gather(smallest())
    assert worst_and_median(one) == {"only": (0, 0)}
    two = dataclasses.replace(one, residual_after=np.array([[0.1], [0.2]]))
    assert worst_and_median(two) == {"worst": (1, 0), "other": (0, 0)}


def test_models_are_curves_on_the_grid_and_few_lines_are_points():
    data = gather(smallest())
    figure = channel_curves(data, 0, 0)
    measured, start, updated = figure["data"][:3]
    assert [t["name"] for t in (measured, start, updated)] == ["measured", "start", "updated"]
    assert measured["mode"] == "markers"
    assert values(measured["x"]) == pytest.approx(data.freq)
    assert len(values(updated["x"])) == len(data.grid) > 10 * len(data.freq)
    assert values(updated["y"]) == pytest.approx(np.abs(data.after_curve[:, 0, 0]), rel=1e-6)


def test_many_measured_lines_are_a_line_and_its_phase_has_gaps_where_it_goes_round(data):
    figure = channel_curves(data, 4, 0)
    assert figure["data"][0]["mode"] == "lines"
    phase = next(t for t in figure["data"] if t["name"] == "updated" and t["yaxis"] == "y2")
    degrees = values(phase["y"])
    drawn = np.abs(np.diff(degrees))
    assert np.nanmax(np.abs(degrees)) <= 180.0
    assert np.nanmax(drawn) <= 180.0


def test_of_a_single_line_the_models_are_points():
    """A curve through one point is not drawn."""
    result = smallest()
    one = result.frf.select(lines=result.frf.freq[:1])
    figure = channel_curves(gather(dataclasses.replace(result, data=one, lines=one.freq)), 0, 0)
    assert [len(values(trace["x"])) for trace in figure["data"]] == [1] * 6
    assert {trace["mode"] for trace in figure["data"]} == {"markers"}


def test_channels_that_are_all_zero_have_no_section():
    """A heading alone would be all that is left of it."""
    result = smallest()
    nothing = dataclasses.replace(result.frf, values=0.0 * result.frf.values)
    page = render(dataclasses.replace(result, data=nothing))
    assert '<section id="frfs">' in page
    assert 'id="channels"' not in page


def test_curves_of_all_channels_need_two_lines():
    """Over a single line there is no frequency axis to draw."""
    result = realistic()
    assert ALL_CHANNELS.applies(PageContent(result))
    one = result.frf.select(lines=result.frf.freq[20:21])
    assert not ALL_CHANNELS.applies(
        PageContent(dataclasses.replace(result, data=one, lines=one.freq))
    )
