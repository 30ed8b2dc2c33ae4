"""The section on modes: rows, maps and words, against the modal table; and what it says without one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from overriding import override
from pages_read import Page, attributes, dump
from report_case import realistic
from updyn.report import modes
from updyn.report.formats import figure_of_agreement, percentage
from updyn.report.modes import MODES, comac_bars, comac_maps, modal_rows
from updyn.report.page import render
from updyn.report.picture import VIEWS, camera
from updyn.report.plots import SEQUENTIAL
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST
from updyn.updating.judge.modal_table import ModalTable


@pytest.fixture(scope="module")
def result():
    one = realistic()
    one = dataclasses.replace(one, start=one.model.scaled({"bay 2": {"stiffness": 0.95}}))
    return dataclasses.replace(one, modes=updyn.modal_table(one))


def test_figures_are_those_of_the_table(result):
    content = PageContent(result)
    table, figures = result.modes, MODES.figures(content)
    assert content.modes is table  # nothing is computed again
    found = table.correlations["updated"]
    for name, values in (("mac-updated", found.mac), ("auto-mac", found.auto_mac)):
        trace = figures[name]["data"][0]
        assert np.array(trace["z"], dtype=float) == pytest.approx(values, abs=1e-6)
        assert (trace["zmin"], trace["zmax"], trace["colorscale"]) == (0.0, 1.0, SEQUENTIAL)
    axes = figures["mac-start"]["layout"]
    assert {len(text) for text in axes["yaxis"]["ticktext"]} == {5}  # four digits and a point
    assert axes["yaxis"]["title"]["text"] == "start model (Hz)"
    assert axes["xaxis"]["title"]["text"] == "test (Hz)"
    comac = {t["name"]: t["x"] for t in figures["comac"]["data"]}
    assert comac["updated (12 pairs)"] == pytest.approx(found.comac())
    assert len(figures["comac"]["layout"]["yaxis"]["ticktext"]) == len(found.dofs)
    crossed = np.array(figures["cross-orthogonality"]["data"][0]["z"], dtype=float)
    assert crossed == pytest.approx(np.abs(table.cross_orthogonality), abs=1e-6)


def test_comac_in_place(result):
    """Each marker stands on its node, as seen from the front, with the lowest value of its sensors."""
    assert not any(name.startswith("comac-map") for name in MODES.figures(PageContent(result)))
    turn = np.linspace(0.0, 3.0, 12)
    geometry = updyn.Geometry(
        range(1, 13),
        np.transpose([np.cos(turn), np.sin(turn), 0.3 * turn]),
        [(i, i + 1) for i in range(1, 12)],
    )
    start = updyn.Model.from_groups(result.start.groups, result.start.dofs, geometry=geometry)
    found = result.modes.correlations["updated"]
    figures = MODES.figures(PageContent(dataclasses.replace(result, start=start)))
    figure = figures["comac-map-updated"]
    assert "comac-map-start" in figures
    structure, sensors = figure["data"]
    expected: dict[int, list[float]] = {}
    for dof, value in zip(found.dofs, found.comac(), strict=True):
        expected.setdefault(dof.node, []).append(value)
    right, up = camera(*VIEWS["front"])[:2]
    assert len(sensors["hovertext"]) == len(expected) > 1
    for x, y, value, text in zip(
        sensors["x"], sensors["y"], sensors["marker"]["color"], sensors["hovertext"], strict=True
    ):
        node = int(text.split(":")[0])
        (place,) = geometry.position([node])
        assert (x, y) == pytest.approx((place @ right, place @ up), abs=1e-5)
        assert value == pytest.approx(min(expected[node]), abs=1e-5)
    assert [int(text) for text in sensors["text"]] == [
        int(text.split(":")[0]) for text in sensors["hovertext"]
    ]
    assert len(structure["x"]) == 3 * len(geometry.lines)
    assert sensors["marker"]["color"] == sorted(sensors["marker"]["color"], reverse=True)
    assert figure["layout"]["yaxis"]["scaleanchor"] == "x"
    assert comac_maps(result.modes, None) == {}
    other = updyn.Geometry([10**6], [[0.0, 0.0, 0.0]])
    assert comac_maps(result.modes, other) == {}


def test_rows_are_those_of_the_table(result):
    rows = modal_rows(result.modes)
    assert len(rows) == len(result.modes.rows) == 12
    cells, kind = rows[0]
    first = result.modes.rows[0]
    assert kind == ""
    assert cells[:2] == ["1", f"{first.test.frequency:.5g}"]
    assert cells[4] == f"{first.start.mac:.3f}"
    assert cells[3] == f"{first.start.change:+.2f} %".replace("-", "−")


def test_a_mode_that_one_lacks_is_marked_and_counted(result):
    table = result.modes
    fewer = ModalTable(table.test.select(np.arange(12) != 3), table.start, table.updated)
    rows = modal_rows(fewer)
    assert [kind for _, kind in rows] == ["", "", "", "open"] + [""] * 8
    assert rows[3][0][1] == "–"
    page = Page(render(dataclasses.replace(result, modes=fewer)))
    assert "11 of 11 modes of the test have a mode of the updated model." in page.words
    assert "1 mode of the model in this band is not found in the test." in page.words


def test_what_is_not_known_is_said(result):
    none = ModalTable(notes=("Too few lines to identify a mode.",))
    page = Page(render(dataclasses.replace(result, modes=none)))
    assert "Modes of test and model Too few lines to identify a mode." in page.words
    assert MODES.figures(PageContent(dataclasses.replace(result, modes=none))) == {}


def test_many_modes_are_folded_away(result, monkeypatch):
    table = result.modes
    often = np.tile(np.arange(12), 3)
    at = often[np.argsort(table.test.frequency[often], kind="stable")]
    test = table.test
    many = type(test)(test.frequency[at], test.loss_factor[at], test.shapes[:, at], test.dofs)
    with_many = dataclasses.replace(result, modes=ModalTable(many, table.start, table.updated))
    assert f"<summary>{36 - REPORT_LIST.unfolded_rows} further modes<" in render(with_many)
    axes = modes.mode_map(np.eye(36), many, many, ("test", "test"), "AutoMAC")["layout"]
    assert axes["xaxis"]["tickvals"] == list(range(0, 36, 4))
    assert axes["yaxis"]["tickvals"] == list(range(0, 36, 2))
    override(monkeypatch, REPORT_LIST, unfolded_rows=35)
    assert "<summary>1 further mode<" in render(with_many)


def test_agreement_in_words_is_no_rounding(result):
    """A MAC that is nearly 1 is not 1, and frequencies that differ by rounding do not differ."""
    table = result.modes
    shapes = table.test.shapes * (1.0 + 1e-3 * np.cos(np.arange(len(table.test.dofs))))[:, None]
    near = dataclasses.replace(
        table.test, frequency=table.test.frequency * (1.0 + 1e-12), shapes=shapes
    )
    words = Page(
        render(dataclasses.replace(result, modes=ModalTable(near, None, table.test)))
    ).words
    assert "Of these pairs the MAC is >0.999 in the median and >0.999 at least;" in words
    assert "frequencies differ by <0.0001 % in the median and <0.0001 % at most." in words
    first = table.test.select([0])
    alone = ModalTable(first, None, table.updated.select([0]))
    words = Page(render(dataclasses.replace(result, modes=alone))).words
    change = abs(alone.rows[0].updated.change)
    assert f"The MAC of the pair is {figure_of_agreement(alone.rows[0].updated.mac)};" in words
    assert f"its frequencies differ by {percentage(change / 100.0)}." in words
    assert comac_bars(alone)["data"][0]["name"] == "updated (1 pair)"


def test_of_many_sensors_those_that_agree_least_are_drawn(result, monkeypatch):
    override(monkeypatch, REPORT_LIST, comac_sensors=3)
    found = result.modes.correlations["updated"]
    start, updated = comac_bars(result.modes)["data"]
    lowest = np.sort(np.argsort(found.comac())[:3])
    assert updated["x"] == pytest.approx(found.comac()[lowest])
    assert updated["text"] == [found.dofs.labels[i] for i in lowest]
    assert start["x"] == pytest.approx(result.modes.correlations["start"].comac()[lowest])
    said = f"Of {len(found.dofs)} sensors the 3 with the lowest values are shown."
    assert said in Page(render(result)).words


def test_close_modes_are_marked_in_table_and_map(result):
    """The test's shapes of two modes, brought to one frequency, are another basis of their plane."""
    table = result.modes
    f, shapes = table.updated.frequency.copy(), table.updated.shapes.copy()
    f[4] = f[3]
    shapes[:, [3, 4]] = shapes[:, [3, 4]] @ (np.array([[3.0, -4.0], [4.0, 3.0]]) / 5.0)
    close = ModalTable(
        dataclasses.replace(table.test, frequency=f, shapes=shapes), None, table.updated
    )
    (one,) = close.correlations["updated"].subspaces
    content = PageContent(dataclasses.replace(result, modes=close))
    figure = MODES.figures(content)["mac-updated"]
    (frame,) = figure["layout"]["shapes"]
    assert [frame[at] for at in ("x0", "x1", "y0", "y1")] == [2.5, 4.5, 2.5, 4.5]
    (text,) = figure["layout"]["annotations"]
    assert (text["text"], text["x"], text["y"]) == (f"{one.mac:.2f}", 3.5, 3.5)
    trace = figure["data"][0]
    single = close.correlations["updated"].mac[3, 4]
    assert trace["hovertext"][3][4].endswith(
        f"MAC {single:.3f} of single shapes<br>subspace MAC {one.mac:.3f}"
    )
    assert "subspace" not in trace["hovertext"][3][5]
    marked = [cells[7] for cells, _ in modal_rows(close)]
    assert [value.endswith("*") for value in marked] == [False] * 3 + [True] * 2 + [False] * 7
    assert marked[3] == f"{one.mac:.3f}*" == "1.000*"
    words = Page(render(dataclasses.replace(result, modes=close))).words
    assert "2 pairs have close modes, whose MAC (*) is that of their subspaces." in words
    assert "subspace MAC 1.000" in words
    assert "only the measured modes are close" in words
    plain = MODES.figures(PageContent(result))["mac-updated"]["layout"]
    assert "shapes" not in plain
    assert "annotations" not in plain


@pytest.mark.needs("browser")
def test_the_section_is_drawn(result, tmp_path):
    path = updyn.write_report(result, tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    opened = (
        "<script>document.querySelectorAll('#modes details').forEach(d => d.open = true)</script>"
    )
    path.write_text(opened.join(text.rsplit("</body>", 1)) + "</body>", encoding="utf-8")
    dom = dump(path, tmp_path / "profile")
    assert "errors" not in attributes(dom)
    section = dom[dom.index('<section id="modes"') :]
    section = section[: section.index("</section>")]
    assert section.count('class="main-svg"') >= 10  # five figures of two layers
