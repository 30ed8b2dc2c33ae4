"""The page on a telephone: nothing is wider than the screen, and long names leave room for the data."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import updyn
from page_waits import wait_for
from programs import program
from report_case import chain, measured
from updyn.model import Model

pytestmark = pytest.mark.needs("browser")

#: Figures as the report makes them: ticks in percent of a logarithmic axis, panels of three stages, and a printed map.
PERCENT = [-98, -95, -90, -80, -50, 0, 100, 300]
COSTS = {
    f"{axis}axis{end}": {"domain": [0.37 * i, 0.37 * i + 0.26], "anchor": f"{other}{end}"}
    if axis == "x"
    else {"anchor": f"{other}{end}"}
    for i, end in enumerate(("", "2", "3"))
    for axis, other in ("xy", "yx")
}
FIGURES = {
    "ticks": {
        "data": [{"x": [0.1, 1.0, 4.0], "y": [0, 1, 2]}],
        "layout": {
            "xaxis": {
                "type": "log",
                "range": [-1.8, 0.7],
                "tickangle": 0,
                "tickvals": [1 + p / 100 for p in PERCENT],
                "ticktext": [f"{p:+g} %" for p in PERCENT],
            }
        },
        "height": 200,
    },
    "panels": {
        "data": [{"x": [0, 1], "y": [0, 1], "xaxis": f"x{e}", "yaxis": f"y{e}"} for e in ("", "2", "3")],
        "layout": COSTS,
        "height": 360,
    },
    "map": {
        "data": [{"type": "heatmap", "z": [[0.5] * 20], "x": list("abcdefghijklmnopqrst"), "y": ["a"],
                  "text": [["0.500"] * 20], "texttemplate": "%{text}"}],
        "layout": {"xaxis": {"type": "category", "dtick": 1}},
        "height": 200,
    },
}  # fmt: skip

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


#: Draws figures in the width of the page; gives the boxes of their ticks, panels, and printed cells.
DRAW = """async (figures) => {
  const drawn = {};
  for (const [name, figure] of Object.entries(figures)) {
    const place = document.querySelector("main").appendChild(document.createElement("div"));
    await updynReport.show(place, figure);
    const texts = [...place.querySelectorAll(".xtick text")];
    drawn[name] = {
      names: texts.map((text) => text.textContent),
      ends: texts.map((text) => { const box = text.getBoundingClientRect(); return [box.left, box.right]; }),
      tops: ["yaxis", "yaxis2", "yaxis3"].map((key) => place._fullLayout[key]?.domain[1]),
      printed: place.querySelectorAll(".heatmap-label").length,
      height: place.clientHeight,
    };
    place.remove();
  }
  return { drawn };
}"""


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
            out[width] |= page.evaluate(DRAW, FIGURES)
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


def test_ticks_leave_room_for_each_other(found):
    """Of eight ticks those next to no change are kept."""
    ticks = found[400]["drawn"]["ticks"]
    assert "+0 %" in ticks["names"]
    assert 3 <= len(ticks["names"]) < len(PERCENT)
    assert all(left[1] < right[0] for left, right in pairwise(ticks["ends"]))
    assert len(found[1280]["drawn"]["ticks"]["names"]) == len(PERCENT)


def test_panels_are_below_each_other(found):
    narrow, wide = (found[width]["drawn"]["panels"] for width in (400, 1280))
    first, second, third = narrow["tops"]
    assert first == 1.0 > second > third > 0.2
    assert wide["tops"] == [1.0, 1.0, 1.0]
    assert narrow["height"] > 2 * wide["height"]


def test_a_map_prints_values_only_where_they_fit(found):
    narrow, wide = (found[width]["drawn"]["map"] for width in (400, 1280))
    assert (narrow["printed"], wide["printed"]) == (0, 20)
    assert all(left[1] < right[0] for left, right in pairwise(narrow["ends"]))
