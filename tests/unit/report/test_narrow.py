"""The page on a telephone: nothing is wider than the screen, and long names leave room for the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from page_waits import wait_for
from programs import program
from report_case import chain, measured
from updyn.model import Model

pytestmark = pytest.mark.needs("browser")

LONG = "left main girder between frames 12 and 17 & <web>"


@pytest.fixture(scope="module")
def result():
    plain = chain(3)
    groups = {f"{LONG}, {name}": group for name, group in plain.groups.items()}
    line = updyn.Geometry([1, 2, 3], np.outer([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]), [(1, 2), (2, 3)])
    model = Model.from_groups(groups, plain.dofs, geometry=line)
    true = model.scaled({next(iter(groups)): {"stiffness": 1.2}})
    frf = measured(true, n_lines=200, responses=["1:Z", "3:Z"], references=["3:Z"])
    unknowns = updyn.parameters(model, stiffness="all")
    return replace(updyn.update(model, frf, unknowns, starts=0), title="Girder")


@pytest.fixture(scope="module")
def found(result, tmp_path_factory):
    sync_api = pytest.importorskip("playwright.sync_api")
    path = updyn.write_report(result, tmp_path_factory.mktemp("narrow") / "report.html")
    out = {}
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program("browser"),
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        for width in (400, 1280):
            page = browser.new_page(viewport={"width": width, "height": 900})
            page.set_default_timeout(60_000)
            page.goto(path.as_uri())
            page.evaluate(
                "() => { updynReport.reveal('viewer'); updynReport.reveal('changes');"
                " document.getElementById('viewer').scrollIntoView(); }"
            )
            wait_for(
                page,
                "() => document.querySelector('[data-figure=changes] .main-svg')"
                " && document.querySelector('.v-bar select')",
            )
            out[width] = page.evaluate(
                """() => {
                  const place = document.querySelector("[data-figure=changes]");
                  return { over: document.documentElement.scrollWidth, room: place._fullLayout._size.w,
                    names: [...place.querySelectorAll(".ytick text")].map((text) => text.textContent),
                    alike: updynReport.shorten(["skin lower inner: stiffness", "skin lower outer: stiffness",
                      "front spar of the wing: mass"], 400),
                    errors: document.documentElement.dataset.errors ?? "" };
                }"""
            )
            page.close()
        browser.close()
    return out


def test_nothing_is_wider_than_the_screen(found):
    assert {width: one["over"] for width, one in found.items()} == {400: 400, 1280: 1280}
    assert {one["errors"] for one in found.values()} == {""}


def test_long_names_leave_room_for_the_data(found):
    assert found[400]["room"] > 120
    assert found[400]["names"] == ["stiffness", *(f"left main …b>, bay {i}" for i in (1, 2, 3))]
    assert found[1280]["names"] == ["stiffness", *(f"{LONG}, bay {i}" for i in (1, 2, 3))]


def test_names_that_differ_in_the_middle_only_are_not_shortened(found):
    assert found[400]["alike"] == [
        "skin lower inner: stiffness",
        "skin lower outer: stiffness",
        "front spar…ing: mass",
    ]
