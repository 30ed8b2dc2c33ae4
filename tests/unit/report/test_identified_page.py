"""The page of identified modes: what its head says, and the axes of its diagram."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from pages_read import Page
from updyn.demos import chain
from updyn.report.identified import DIAGRAM, Identified, render
from updyn.report.section import Content


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


def test_the_level_has_its_unit(frf, modes):
    figure = DIAGRAM.figures(Content(further={"identified": Identified(modes, frf)}))["diagram"]
    axis = figure["layout"]["yaxis2"]
    assert axis["title"]["text"] == "accelerance,<br>rms ((m/s²)/N)"
    assert axis["exponentformat"] == "power"
    twist = dataclasses.replace(frf, references=["2:X", "12:RX"])
    figure = DIAGRAM.figures(Content(further={"identified": Identified(modes, twist)}))["diagram"]
    said = figure["layout"]["yaxis2"]["title"]["text"]
    assert said == "accelerance,<br>rms (several units)"
