"""The section on uncertainty: intervals in standard deviations, the band of the widest channel, and what is not so."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.frf import unit
from updyn.report.formats import estimate, format_padded
from updyn.report.page import render
from updyn.report.uncertainty import band_figure, intervals_figure
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Interval, Profile, Profiles
from updyn.updating.problem.parameters import Parameter, ParameterSet


@pytest.fixture(scope="module")
def result():
    groups = {
        "base": updyn.Group([[1000.0, 0.0], [0.0, 0.0]], np.diag([1.0, 0.0]), loss_factor=0.03),
        "top": updyn.Group(
            [[600.0, -600.0], [-600.0, 600.0]], np.diag([0.0, 1.0]), loss_factor=0.05
        ),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    frf = updyn.response(model, np.linspace(1.0, 9.0, 40), ["1:X", "2:X"], ["1:X"])
    noise = np.random.default_rng(0).normal(size=(2, *frf.values.shape)) * 0.02 / np.sqrt(2)
    data = updyn.FRF(
        frf.freq,
        frf.values * (1 + noise[0] + 1j * noise[1]),
        frf.responses,
        frf.references,
        "receptance",
    )
    unknowns = updyn.parameters(model, stiffness="all", loss_factor=["top"])
    return updyn.update(model, data, unknowns, noise={"relative": 0.02}, starts=0)


def profiles(result, spans):
    found = []
    for name, (low, high) in spans.items():
        value, at = result.values[name], np.array([low, result.values[name], high])
        interval = Interval(low, value, high, 0.0)
        found.append(
            Profile(
                name,
                value,
                at,
                np.array([1.92, 0.0, 1.92]),
                np.ones((3, 3)),
                (interval,),
                "level",
                "bound",
            )
        )
    return Profiles(tuple(found), 0.95, 1.92)


def draws(result, message=""):
    rng = np.random.default_rng(1)
    names = result.parameters.names
    mean, std = (np.array([table[n] for n in names]) for table in (result.values, result.std))
    values = mean + std * rng.standard_normal((4, 100, 3))
    more = {k: np.ones(3) for k in ("r_hat", "ess_bulk", "ess_tail")}
    about = (
        mean,
        std,
        result.parameters.lower,
        result.parameters.upper,
        result.parameters.is_factor,
    )
    return Draws("sampling", tuple(names), values, *about, more, {}, not message, message)


def test_bars_are_standard_deviations_of_laplace(result):
    factor, loss = "base.stiffness", "top.loss_factor"
    v, s = result.values, result.std
    spans = {
        factor: (
            v[factor] * np.exp(-2 * s[factor] / v[factor]),
            v[factor] * np.exp(99 * s[factor] / v[factor]),
        ),
        loss: (v[loss] - 1.5 * s[loss], v[loss] + 3 * s[loss]),
    }
    figure = intervals_figure(result, profiles(result, spans))
    laplace, own = figure["data"]
    assert (laplace["name"], own["name"]) == ("Laplace", "profile")
    assert laplace["error_x"]["array"] == pytest.approx([1.96, 1.96], abs=1e-3)
    assert own["error_x"]["arrayminus"] == pytest.approx([2.0, 1.5])
    assert own["error_x"]["array"] == pytest.approx([8.0, 3.0])  # cut at what is drawn
    assert len(figure["layout"]["yaxis"]["ticktext"]) == 2


def split(channel):
    response, reference = channel.split(" / ")
    return [response], [reference]


def test_the_band_is_that_of_the_channel_known_least(result):
    figure, channel = band_figure(result, draws(result))
    low, high, line, measured = figure["data"]
    widths = {}
    for response in ("1:X", "2:X"):
        band = updyn.predict(draws(result).of(result), result.frf.freq, [response], ["1:X"])
        widths[f"{response} / 1:X"] = np.median(np.log(band.upper / band.lower))
    assert channel == max(widths, key=widths.get)
    assert high["fill"] == "tonexty"
    assert (np.array(low["y"]) <= line["y"]).mean() > 0.95
    assert (np.array(high["y"]) >= line["y"]).mean() > 0.95
    assert len(measured["y"]) == 40
    assert measured["x"] == pytest.approx(result.frf.freq)
    # Between the lines of the data the model is drawn to its peak.
    dense = updyn.response(result.model, np.linspace(1.0, 9.0, 20_001), *split(channel)).values
    assert max(line["y"]) == pytest.approx(np.abs(dense).max(), rel=5e-3)
    assert max(line["y"]) > max(line["y"][i] for i in np.searchsorted(line["x"], measured["x"]))
    axis = figure["layout"]["yaxis"]
    unit_of = unit(result.frf.quantity, *channel.split(" / "))
    assert axis["title"]["text"] == f"{result.frf.quantity} ({unit_of})"
    assert axis["exponentformat"] == "power"  # not 2µ


def test_the_page_shows_it_and_what_it_is_worth(result):
    text = render(result, draws(result, "Not converged: independent ensembles disagree."))
    assert '<section id="uncertainty">' in text
    assert "Not converged: independent ensembles disagree." in text
    assert "effective draws" in text
    assert text.count('data-figure="uncertainty-') == 2
    assert '<section id="uncertainty">' not in render(result)
    one = profiles(result, {"base.stiffness": (0.9, 5.0)})
    assert "no upper end within its bounds" in render(result, one)


def test_ends_have_the_digits_of_the_standard_deviation(result):
    """1.1000 to 1.1008 is not 1.1 to 1.101."""
    std = result.std["base.stiffness"]
    table = render(result, profiles(result, {"base.stiffness": (0.98765, 1.02345)}))
    section = table[table.index('<section id="uncertainty">') :].split("</section>")[0]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", section)
    shown = [estimate(value, std) for value in (result.values["base.stiffness"], 0.98765, 1.02345)]
    assert [cells[0], *cells[2:4]] == shown
    assert cells[1] == format_padded(std, 2)
    assert ">note<" in section  # here there is one
    quiet = render(result, draws(result))
    section = quiet[quiet.index('<section id="uncertainty">') :].split("</section>")[0]
    assert ">note<" not in section


def test_what_a_sensor_reads_too_much_is_taken_off(result):
    """The band is that of the structure."""
    found = profiles(result, {"base.stiffness": (0.9, 1.1)})
    _, channel = band_figure(result, found)
    i = result.frf.responses.labels.index(channel.split(" / ")[0])
    gain = Parameter(result.frf.responses.labels[i], "calibration", 1.0, 0.5, 2.0, prior_std=0.3)
    read = result.frf.values.copy()
    read[:, i] *= 1.3
    odd = replace(
        result,
        data=replace(result.frf, values=read),
        parameters=ParameterSet((*result.parameters, gain)),
        values=dict(result.values) | {gain.name: 1.3},
        std=dict(result.std) | {gain.name: 0.01},
        covariance=np.pad(result.covariance, (0, 1), constant_values=0.0),
    )
    figure, same = band_figure(odd, found)
    assert same == channel
    assert figure["data"][3]["y"] == pytest.approx(np.abs(result.frf.values[:, i, 0]), rel=1e-6)
