"""The section on model error: the map by value, what is said of places and suspects, and of other outcomes."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from pages_read import Page
from report_case import left_over, realistic
from updyn.report.page import render
from updyn.report.residual import misfit_map, shown_channels
from updyn.report.settings import REPORT_LIST
from updyn.updating.judge.adequacy import assess_residual
from updyn.updating.result import JointResult


@pytest.fixture(scope="module")
def found():
    return left_over()


def words(**changes):
    return Page(render(realistic(**changes))).words


def test_the_map_has_the_misfit_of_every_channel_and_band(found):
    figure = misfit_map(found)
    heat, alike, large = figure["data"]
    assert heat["type"] == "heatmap"
    assert 10.0 ** np.array(heat["z"]) == pytest.approx(
        np.clip(found.misfit.reshape(8, -1), 0.3, 10.0)
    )
    edges = np.array(heat["x"])
    assert edges[[0, -1]].tolist() == [20.0, 220.0]
    assert (edges[1:-1] > found.bands[:-1, 1]).all()
    assert (edges[1:-1] < found.bands[1:, 0]).all()
    assert figure["layout"]["yaxis"]["ticktext"][5] == "6:-Z / 12:Z"
    (at,) = np.flatnonzero(found.bands[:, 0] == found.worst[0].low)
    assert (alike["name"], alike["y"], alike["x"]) == (
        "serially correlated",
        [5],
        [np.mean(edges[at : at + 2])],
    )
    assert large["name"] == "too large"
    assert {*large["y"]} == {0, 5}
    assert "misfit 3.72 times the noise<br>correlated over 12 lines" in heat["hovertext"][5][at]
    assert heat["colorbar"]["ticktext"][-1] == "≥ 10"


def test_the_section_says_where_and_what_would_explain_it(found):
    text = words()
    assert found.verdict in text
    assert "Marked: serially correlated" in text
    assert "Residual model error the model cannot follow the data everywhere" in text
    worst = found.worst[0]
    assert (worst.response, worst.reference) == ("6:-Z", "12:Z")
    assert f"6:-Z / 12:Z 121.6 to 159.3 {worst.near:.4g} 3.72 12 lines < 10⁻⁹ < 10⁻⁹" in text
    assert "stiffness of bay 9 93 % up by 22 % 40 %" in text
    assert "loss factor of bay 9 20 % −0.01 40 %" in text
    assert "at most 2 % of fits to pure noise are suspected" in text


def test_without_a_suspect_other_causes_are_named(found):
    assert "look at the sensors, at joints and parts" in words(
        adequacy=dataclasses.replace(found, explained_by=())
    )


def test_a_residual_that_was_not_tested_is_said_so():
    page = Page(render(realistic(adequacy=None)))
    assert "The residual was not tested against noise." in page.words
    assert "Residual noise" not in page.words
    assert misfit_map(None) is None


def noise(shape, absolute=True):
    rng = np.random.default_rng(0)
    e = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    labels = [f"{i}:X" for i in range(shape[1])], [f"{j}:X" for j in range(shape[2])]
    freq = np.linspace(1.0, 50.0, shape[0])
    return assess_residual(e, np.ones(shape), freq, *labels, n_unknowns=0, absolute=absolute)


def test_noise_is_called_noise_and_its_size_is_relative_where_it_was_estimated():
    quiet = noise((40, 3, 1), absolute=False)
    text = words(adequacy=quiet)
    assert "Residual noise consistent with the model" in text
    assert "compared with that of all the rest (F)" in text
    assert "over the typical misfit, as the size of the noise was taken from it, by channel" in text
    assert "Suspicious channels and bands" not in text
    assert "Marked:" not in text  # nothing is
    figure = misfit_map(quiet)
    assert len(figure["data"]) == 1
    assert figure["layout"]["showlegend"] is False


def test_of_many_channels_the_worst_are_shown():
    many = noise((20, 50, 2))
    at = shown_channels(many)
    assert len(at) == REPORT_LIST.misfit_channels
    shown = many.misfit[tuple(at.T)].max(axis=1)
    rest = np.setdiff1d(np.arange(100), at[:, 0] * 2 + at[:, 1])
    assert many.misfit.reshape(100, -1)[rest].max(axis=1).max() <= shown.min()
    assert f"The {REPORT_LIST.misfit_channels} worst of 100 channels are shown." in words(
        adequacy=many
    )


def test_channels_without_data_are_left_out():
    rng = np.random.default_rng(0)
    e = rng.standard_normal((30, 3, 1)) + 1j * rng.standard_normal((30, 3, 1))
    e[:, 1] = np.nan
    part = assess_residual(
        e,
        np.ones(e.shape),
        np.arange(1.0, 31.0),
        ["1:X", "2:X", "3:X"],
        ["1:X"],
        n_unknowns=0,
        absolute=True,
    )
    assert misfit_map(part)["layout"]["yaxis"]["ticktext"] == ["1:X / 1:X", "3:X / 1:X"]


def test_the_page_of_several_tests_says_what_is_left_of_each_and_the_worst_of_all():
    good = realistic(adequacy=noise((40, 3, 1)))
    both = JointResult(
        {"free": good, "locked": realistic(), "old": realistic(adequacy=None)}, "Three tests"
    )
    html = render(both)
    assert "Residual model error the model cannot follow the data everywhere" in Page(html).words
    section = html[html.index('<section id="tests">') :].split("</section>")[0]
    last = [
        re.findall(r"<td[^>]*>([^<]*)</td>", row)[-1]
        for row in re.findall(r"<tr>.*?</tr>", section)[1:]
    ]
    assert last == ["noise", "model error", "–"]


def test_a_test_of_modes_has_no_agreement_of_frfs():
    of_modes = realistic(correlation={"before": {}, "after": {}}, adequacy=None)
    html = render(JointResult({"free": realistic(), "modes": of_modes}, "Two tests"))
    section = html[html.index('<section id="tests">') :].split("</section>")[0]
    assert re.findall(r"<td[^>]*>([^<]*)</td>", section.split("<tr>")[-1])[1:] == ["–"] * 5
