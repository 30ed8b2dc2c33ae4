"""The page of a comparison: what it draws is what the models answer; channel, table, escapes; in a real browser."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import updyn
from pages_read import Page, attributes, dump, values
from updyn.comparison import Comparison, Fewest, Row
from updyn.demos.gear_train import known_masses, true_model, true_values
from updyn.report import write_comparison
from updyn.report.comparison import gather_curves, is_geometric, render
from updyn.report.formats import number

LINES = np.linspace(5.0, 60.0, 12) / (2.0 * np.pi)
NAMES = ["equation-error", "log", "rfm", "frf-sensitivity", "reduced-frf"]


@pytest.fixture(scope="module")
def found() -> Comparison:
    """The paper's method, the one that it compares with, one that breaks down, and one that is refused."""
    start = known_masses()
    data = updyn.response(true_model(), LINES, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    truth = {name: value for name, value in true_values().items() if not name.endswith("mass")}
    return updyn.compare(
        start,
        data,
        unknowns,
        NAMES,
        truth=truth,
        validation=["1:RZ"],
        fewest=True,
        title="Gears <b>'\"& 1</b>",
    )


@pytest.fixture(scope="module")
def page(found, tmp_path_factory):
    return write_comparison(found, tmp_path_factory.mktemp("page") / "compare.html")


@pytest.fixture(scope="module")
def text(page):
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def figures(text):
    return json.loads(re.search(r'id="updyn-figures">(.*?)</script>', text)[1])


def test_the_channel_is_the_one_with_the_worst_start(found):
    curves = gather_curves(found)
    start, test = found.tests[0].model, found.tests[0].frf
    answer = updyn.response(start, test.freq, test.responses, test.references).values
    off = np.median(np.abs(20 * np.log10(np.abs(answer / test.values))), axis=0)[:, 0]
    assert curves.response == test.responses.labels[int(np.argmax(off))]
    assert curves.reference == "2:RZ"
    assert curves.misfit == pytest.approx(off.max())


def test_the_papers_figure_holds_what_the_models_answer(found, figures):
    curves = gather_curves(found)
    measured, before, paper, reduced = figures["pair"]["data"]
    assert [t["name"] for t in (measured, before, paper, reduced)] == [
        "measured",
        "before",
        "after, equation-error",
        "after, reduced-frf",
    ]
    np.testing.assert_allclose(values(measured["x"]), LINES, rtol=1e-6)
    for trace, model in (
        (measured, true_model()),
        (before, known_masses()),
        (paper, true_model()),
        (reduced, found["reduced-frf"].result.model),
    ):
        at = curves.lines if trace is measured else curves.freq
        expected = np.abs(
            updyn.response(model, at, [curves.response], [curves.reference]).values[:, 0, 0]
        )
        np.testing.assert_allclose(values(trace["x"]), at, rtol=1e-6)
        np.testing.assert_allclose(values(trace["y"]), expected, rtol=1e-5)
    assert measured["mode"] == "markers"  # thirty lines: nothing is drawn between them


def test_a_panel_for_each_method_that_gave_an_answer(found, figures, text):
    panels = [name for name in figures if name.startswith("panel")]
    assert len(panels) == 3
    for row in found:
        assert (f"{row.method} gave no result" in text) == (row.status == "failed")
    assert figures["panel-0"]["data"][2]["y"] == figures["pair"]["data"][2]["y"]


def test_bars(found, figures, text):
    assert "no bar where an unknown is not determined" in text
    error = figures["error"]
    shown = dict(zip(error["layout"]["yaxis"]["ticktext"], error["data"][0]["x"], strict=True))
    assert found["reduced-frf"].status == "not-identifiable"
    assert list(shown) == ["equation-error", "log"]  # what arrived, with all unknowns determined
    for name, value in shown.items():
        assert value == pytest.approx(found[name].error_max)
    assert error["layout"]["shapes"][0]["x0"] == 0.01
    low, high = error["layout"]["xaxis"]["range"]
    assert low < np.log10(min(shown.values())) < np.log10(max(shown.values())) < high
    work = dict(
        zip(
            figures["work"]["layout"]["yaxis"]["ticktext"],
            figures["work"]["data"][0]["x"],
            strict=True,
        )
    )
    assert work["frf-sensitivity"] == found["frf-sensitivity"].lines_solved


def test_table_and_limits(found, text):
    table = re.search(r'<section id="table">.*?</section>', text, re.DOTALL)[0]
    cells = {
        row[0]: row[1:]
        for row in (
            re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", r) for r in re.findall(r"<tr.*?</tr>", table)
        )
    }
    heads = cells["method"]
    assert cells["equation-error"][heads.index("unknowns")] == "12 of 12"
    assert cells["equation-error"][heads.index("min lines")] == str(
        found["equation-error"].fewest.count
    )
    assert cells["equation-error"][heads.index("held out")] == "0 dB"
    assert cells["rfm"][0] == "does not apply"
    error = cells["equation-error"][heads.index("error")]
    assert error == number(found["equation-error"].error_max, 2)
    assert "·10" in error
    assert cells["frf-sensitivity"][heads.index("error")] == "–"
    assert "rfm needs the motion of all 7 DOFs" in text
    assert "Bao, Wang &amp; Cheng 2010" in text


def test_methods_that_read_alike_are_all_the_best(found):
    """Of 0.0390 and 0.0391 dB, both 0.039 dB on the page, neither is better to the reader."""
    misfits = {"equation-error": 0.0390, "log": 0.0391, "reduced-frf": 0.3}
    rows = []
    for row in found.rows:
        after = {"db_error_median": misfits.get(row.method, np.nan)}
        rows.append(replace(row, fitted=dict(row.fitted) | {"after": after}))
    words = Page(render(replace(found, rows=tuple(rows)))).words
    assert "Least misfit after 0.039 dB equation-error and log" in words


def test_nothing_is_interpreted_and_nothing_is_loaded(text):
    title = re.search(r"<title>(.*?)</title>", text)[1]
    assert html.unescape(title).startswith("Gears <b>'\"& 1</b>: methods")
    assert "<" not in title
    assert "<b>'" not in text
    body = text[text.index("<body>") : text.index("<script")]
    assert "http" not in body


def test_a_comparison_that_knows_nothing_has_a_page(found, tmp_path):
    """One method that does not apply, no truth, no fewest lines; then one that was stopped."""
    row = Row("rfm", "", "does not apply", "why <not>", fixed=("a",))
    bare = Comparison((row,), found.tests, found.parameters, stopped=True, not_run=("log",))
    text = write_comparison(bare, tmp_path / "bare.html").read_text(encoding="utf-8")
    assert "why &lt;not&gt;" in text
    assert "Not run: log." in text
    assert "0 of 1 method can be used" in text
    figures = json.loads(re.search(r'id="updyn-figures">(.*?)</script>', text)[1])
    assert figures == {}


def test_of_several_tests_the_one_with_the_worst_channel_is_drawn(found):
    (test,) = found.tests
    data = test.frf
    near = updyn.Test(test.model, updyn.response(test.model, data.freq, ["2:RZ"], ["2:RZ"]), "near")
    far = updyn.Test(test.model, data, "far")
    both = updyn.compare_jointly([near, far], found.parameters, ["log"])
    curves = gather_curves(both)
    assert curves.test == "far"
    model = both["log"].result["far"].model
    expected = updyn.response(model, curves.freq, [curves.response], [curves.reference]).values[
        :, 0, 0
    ]
    np.testing.assert_allclose(curves.after["log"], expected)


def test_many_lines_are_thinned_and_drawn_as_a_line(found, tmp_path):
    (test,) = found.tests
    freq = np.geomspace(0.5, 50.0, 3000)
    data = updyn.response(true_model(), freq, ["3:RZ"], ["2:RZ"])
    many = updyn.compare(test.model, data, found.parameters, ["log"], lines=freq[::60])
    curves = gather_curves(many)
    assert len(curves.freq) <= 2200
    assert curves.fitted.sum() == 50
    path = write_comparison(many, tmp_path / "many.html")
    figures = json.loads(
        re.search(r'id="updyn-figures">(.*?)</script>', path.read_text(encoding="utf-8"))[1]
    )
    assert figures["panel-0"]["data"][0]["mode"] == "lines"
    assert figures["panel-0"]["layout"]["xaxis"]["type"] == "log"


def test_between_the_lines_of_the_data_the_curves_reach_their_peaks(found):
    """Thirty lines miss the resonances; the curve of each model has its peaks, as a fine grid has them."""
    curves = gather_curves(found)
    assert set(curves.lines) <= set(curves.freq)
    fine = np.geomspace(LINES[0], LINES[-1], 40_000)
    at = [curves.response], [curves.reference]
    for model, drawn in (
        (found.tests[0].model, curves.before),
        (found["log"].result.model, curves.after["log"]),
    ):
        answer = np.abs(updyn.response(model, fine, *at).values[:, 0, 0])
        inner = answer[1:-1]
        peaks = 1 + np.flatnonzero((inner > answer[:-2]) & (inner > answer[2:]))
        assert len(peaks) >= 2
        for peak in peaks:
            near = np.abs(curves.freq - fine[peak]) < 0.02 * fine[peak]
            assert np.abs(drawn[near]).max() > 0.9 * answer[peak]


def test_spacing():
    assert is_geometric(np.geomspace(1, 100, 50))
    assert not is_geometric(np.linspace(1, 100, 50))
    assert not is_geometric(np.geomspace(50, 100, 50))


def test_fewest_lines_not_found_and_why(found, tmp_path):
    rows = (
        Row("a", "", "converged", "", updated=("x",), fewest=Fewest(None, (), ((3, 5.0),))),
        Row(
            "b",
            "",
            "stalled",
            "",
            updated=("x",),
            fewest=Fewest(None, note="its own answer is stalled"),
        ),
    )
    some = Comparison(rows, found.tests, found.parameters, tolerance=0.01, rule="Rule.")
    text = write_comparison(some, tmp_path / "some.html").read_text(encoding="utf-8")
    lines = re.search(r'<section id="lines">.*?</section>', text, re.DOTALL)[0]
    assert ">none<" in lines
    assert "b: its own answer is stalled" in lines


@pytest.mark.needs("browser")
def test_the_page_is_drawn(page, figures, tmp_path):
    dom = dump(page, tmp_path / "profile")
    found = attributes(dom)
    assert "errors" not in found, found["errors"]
    assert len(re.findall(r'class="main-svg"', dom)) >= 2 * len(figures)
    assert "after, reduced-frf" in dom
    assert not re.search(r"<b>'", dom)
