"""The page of identified modes: what its head says, and what its figure is made of."""

from __future__ import annotations

import base64
import dataclasses

import numpy as np
import pytest

import updyn
from overriding import override
from pages_read import Page
from updyn.demos import chain
from updyn.modal.synthesis import line_weights
from updyn.report.identified import render
from updyn.report.picker import IdentifiedModes, picker_data, picker_figure
from updyn.report.settings import REPORT_SIZE


@pytest.fixture(scope="module")
def frf():
    return chain.measure()


@pytest.fixture(scope="module")
def modes(frf):
    return updyn.identify_modes(frf)


def test_the_head_says_what_was_measured_and_which_mode_is_the_least_sure(frf, modes):
    words = Page(render(modes, frf)).words
    assert "5 responses × 2 references, 60 lines from 0.6349 to 22.7 Hz" in words
    least = int(np.argmin(modes.quality))
    assert f"6 modes; the least sure is the one at {modes.frequency[least]:.4g} Hz" in words


def test_modes_of_unknown_quality_have_a_page(frf, modes):
    unknown = dataclasses.replace(modes, quality=np.full(len(modes), np.nan))
    words = Page(render(unknown, frf)).words
    assert "6 modes." in words
    assert "least sure" not in words


def decoded(text, dtype):
    return np.frombuffer(base64.b64decode(text), dtype=dtype)


def test_the_indicator_is_behind_the_poles_on_its_own_axis(frf, modes):
    figure = picker_figure(IdentifiedModes(modes, frf, [None] * 6))
    behind, front = figure["layout"]["yaxis"], figure["layout"]["yaxis2"]
    assert front["overlaying"] == "y"  # plotly draws what overlays over the other
    assert (behind["type"], behind["side"], front["side"]) == ("log", "right", "left")
    assert behind["title"]["text"] == "CMIF ((m/s²)/N)"
    axes = {t["meta"][:4]: t["yaxis"] for t in figure["data"] if "meta" in t}
    assert (axes["cmif"], axes["mode"], axes["peak"]) == ("y", "y2", "y2")


def test_the_script_has_what_was_measured(frf, modes):
    data = picker_data(IdentifiedModes(modes, frf, [None] * 6))
    values = decoded(data["values"], "<c8").reshape(10, 60)
    assert values == pytest.approx(frf.values.reshape(60, 10).T, rel=1e-6)
    assert decoded(data["freq"], "<f8") == pytest.approx(frf.freq)
    assert decoded(data["weights"], "<f8") == pytest.approx(line_weights(frf))
    indicator = decoded(data["cmif"], "<f4").reshape(2, 60)
    accelerance = frf.converted("accelerance").values
    assert indicator[0] == pytest.approx([np.linalg.norm(H, 2) for H in accelerance], rel=1e-6)
    names = [(str(i), str(j)) for i in frf.responses for j in frf.references]
    assert [c["name"] for c in data["channels"]] == [f"response {i}, force {j}" for i, j in names]


def test_the_first_channel_is_the_one_that_agrees_least(frf, modes):
    spoilt = frf.values.copy()
    rng = np.random.default_rng(4)
    spoilt[:, 2, 1] = rng.standard_normal((60, 2)) @ (1, 1j) * np.abs(spoilt[:, 2, 1]).mean()
    data = picker_data(IdentifiedModes(modes, dataclasses.replace(frf, values=spoilt), [None] * 6))
    assert data["worst"] == 2 * 2 + 1


def test_of_too_many_channels_those_that_agree_least_are_drawn(frf, modes, monkeypatch):
    override(monkeypatch, REPORT_SIZE, frf_bytes=8 * 60 * 3)
    found = IdentifiedModes(modes, frf, [None] * 6)
    data = picker_data(found)
    least = np.sort(np.argsort(found.frac.ravel())[:3])
    values = decoded(data["values"], "<c8").reshape(3, 60)
    assert values == pytest.approx(frf.values.reshape(60, 10).T[least], rel=1e-6)
    assert "the 3 of 10 channels with the lowest FRAC are drawn" in data["note"]
    assert data["note"] in Page(render(modes, frf)).words


def test_a_channel_that_is_zero_is_not_drawn(frf, modes):
    dead = frf.values.copy()
    dead[:, 3, 0] = 0.0
    found = IdentifiedModes(modes, dataclasses.replace(frf, values=dead), [None] * 6)
    data = picker_data(found)
    assert len(data["channels"]) == 9
    names = [channel["name"] for channel in data["channels"]]
    assert f"response {frf.responses[3]}, force {frf.references[0]}" not in names
    assert data["note"] == "Not drawn, as it is zero at all lines: 1 channel."
    assert found.worst != 6


def test_pairs_of_one_shape_are_named(frf, modes):
    assert "No two modes have a MAC of 0.9 or more" in Page(render(modes, frf)).words
    shapes = np.concatenate([modes.shapes, modes.shapes[:, :2]], axis=1)
    f = np.concatenate([modes.frequency, modes.frequency[:2] * [1.0005, 2.9]])
    doubled = updyn.ModeSet(f, shapes, modes.dofs, np.full(8, 0.02))
    words = Page(render(doubled, frf)).words
    first, second = f[0], f[6]
    assert f"{first:.5g} and {second:.5g} Hz: MAC 1.00, and their resonances overlap." in words
    assert f"{f[1]:.5g} and {f[7]:.5g} Hz: MAC 1.00. Their resonances do not overlap" in words


def test_modes_whose_damping_is_not_known_have_a_page(frf, modes):
    bare = updyn.ModeSet(modes.frequency, modes.shapes, modes.dofs)
    assert "6 modes." in Page(render(bare, frf)).words
