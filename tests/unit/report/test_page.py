"""The page as a document: what it says, that it loads nothing, that no text of the user is taken for markup."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import sys
from importlib import resources

import numpy as np
import pytest

import updyn
from pages_read import Page
from report_case import HOSTILE, hostile, largest, measured, realistic, smallest
from updyn.errors import FormatError, OptionError
from updyn.model import Group, Model
from updyn.remedy import Remedy
from updyn.report.page import POLICY, render
from updyn.report.section import SECTIONS, PageContent, select_sections
from updyn.report.templates import asset
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import STATUSES


def embedded(html, name):
    found = re.search(
        rf'<script type="application/json" id="{name}">(.*?)</script>', html, re.DOTALL
    )
    return json.loads(found[1])


@pytest.fixture(scope="module")
def html():
    return render(realistic())


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_elements_are_closed_in_order(page):
    assert page.open == []


def navigation(html):
    """The addresses of the table of contents."""
    return re.findall('href="([^"]*)"', re.search("<nav.*?</nav>", html, re.DOTALL)[0])


def test_sections_stand_in_order_and_the_contents_lead_to_them(page, html):
    # The model has no geometry, and its unknowns were fitted freely.
    sections = select_sections(PageContent(realistic()))
    assert [s.place for s in sections] == sorted(s.place for s in sections)
    anchors = [s.anchor for s in sections if s.anchor not in ("structure", "held")]
    first = ["verdict", "next-step", "evidence"]
    assert [a["id"] for a in page.of("section")] == [*first, *anchors]
    by_name = {s.name: s.anchor for s in reversed(sections) if s.anchor in anchors}
    assert navigation(html) == [f"#{name}" for name in anchors if name in by_name.values()]


def test_policy_and_language(page):
    assert page.of("html")[0]["lang"] == "en"
    policies = [
        a["content"] for a in page.of("meta") if a.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policies == [POLICY]
    assert POLICY.startswith(
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:;"
        " font-src data:"
    )


def test_nothing_is_loaded_from_elsewhere(page):
    for tag, attrs in page.elements:
        for name in ("src", "href", "action", "srcset", "poster", "data"):
            if name in attrs:
                assert attrs[name].startswith(("#", "data:")), (tag, attrs)
    assert not page.of("iframe")
    assert not page.of("img")


def test_own_scripts_styles_and_templates_name_no_address():
    texts = [
        asset(name)
        for name in (
            "report.css",
            "report.js",
            "curves.js",
            "overlay.js",
            "lsfd.js",
            "picks.js",
            "watch.js",
        )
    ]
    templates = resources.files("updyn.report") / "templates"
    texts += [file.read_text(encoding="utf-8") for file in templates.iterdir()]
    assert len(texts) > 10
    for text in texts:
        assert "://" not in text
        assert "url(" not in text
        assert "@import" not in text


def test_verdict_in_parts(page):
    assert "✓ Converged yes After 6 iterations." in page.words
    assert (
        "✗ Determined no The fit converged, but one combination of unknowns changes nothing that"
        " was measured." in page.words
    )
    assert "Next step A sensor at 5:Z, or lines around 210 Hz" in page.words


def test_no_sentence_of_the_message_is_said_twice(page):
    """The verdict on the residual, too, is on the page once, where the message has it."""
    verdict = realistic().adequacy.verdict
    told = Page(
        render(realistic(message=f"The fit ended so. {verdict}", steps=(Remedy("Do this."),)))
    ).words
    told = told.replace(" . ", ". ")  # after a link
    for sentence in ("The fit ended so.", verdict, "Next step Do this."):
        assert told.count(sentence) == 1
    advice = realistic().identifiability.advice
    assert Page(render(realistic(steps=(Remedy(advice),)))).words.count(advice) == 1


def test_what_is_not_on_the_first_screen_is_folded(page, html):
    sections = select_sections(PageContent(realistic()))
    first = [s.anchor for s in sections if s.first_screen]
    assert first == []
    folded = re.findall(r'<section id="([\w-]+)">\s*<details class="fold">', html)
    assert folded == [
        s.anchor for s in sections if not s.first_screen and s.anchor not in ("structure", "held")
    ]


@pytest.mark.parametrize("status", STATUSES)
def test_every_status_has_its_words_and_badge(status):
    page = Page(render(realistic(status=status)))
    (verdict,) = [a["class"] for a in page.of("p") if a.get("class", "").startswith("verdict")]
    colours = {"converged": "good", "not-credible": "bad", "failed": "bad"}
    assert verdict == f"verdict {colours.get(status, 'warn')}"
    assert len([a for a in page.of("details") if a.get("class", "").startswith("mark ")]) == 2
    assert status not in ("max-iterations", "not-identifiable") or status not in page.words


def test_table_of_unknowns(html):
    rows = re.findall(r"<tr[^>]*><th scope=\"row\">(.*?)</tr>", html)
    cells = {
        tuple(re.split(r"<[^>]+>+", r.replace("</th>", "").replace("</td>", ""))) for r in rows
    }
    assert (
        "bay 2",
        "stiffness",
        "1",
        "0.7200",
        "−28 %",
        "0.0029",
        "0.7144 to 0.7257",
        "0.4 to 2.5",
        "",
    ) in cells
    assert (
        "bay 5",
        "stiffness",
        "1",
        "1.3",
        "+30 %",
        "–",
        "open",
        "0.4 to 2.5",
        "not determined by the data",
    ) in cells
    found = next(c for c in cells if c[:2] == ("bay 8", "stiffness"))
    assert found[-1] == "at its lower bound"


def test_a_table_of_unknowns_without_notes_has_no_column_of_them():
    table = render(smallest()).split('<section id="unknowns">')[1].split("</table>")[0]
    heads = re.findall(r"<th scope=\"col\"[^>]*>(.*?)</th>", table)
    assert heads[-1] == "bounds"
    rows = re.findall(r"<tr[^>]*><th scope=\"row\">.*?</tr>", table)
    assert rows
    assert {row.count("<td") + 1 for row in rows} == {len(heads)}


def test_open_and_determined_combinations_are_in_words(page):
    assert "stiffness of bay 5 up (1), mass of bay 5 down (0.62)" in page.words
    assert "1 × mass of bay 5 + 0.62 × stiffness of bay 5" in page.words
    assert "A sensor at 5:Z, or lines around 210 Hz, would determine what is open." in page.words


def two_answers():
    """A fit whose unknowns are all determined near each of two answers."""
    result = realistic()
    ident = dataclasses.replace(
        result.identifiability,
        rank=7,
        condition=40.0,
        null_directions=[],
        determined_directions=[],
        advice="",
    )
    std = dict.fromkeys(result.std, 0.01)
    values = dict(result.values) | {"bay 2.stiffness": 1.302, "bay 11.loss_factor": 0.072}
    others = (
        Alternative(values, 1.83, "7:Z", 0.416),
        Alternative(dict(result.values) | {"bay 5.mass": 1.4}, 0.9),
    )
    return realistic(identifiability=ident, std=std, alternatives=others)


def test_answers_that_fit_equally_well_are_a_table():
    page = Page(render(two_answers()))
    assert "Several answers fit" in page.words
    assert "Not all unknowns determined" not in page.words
    assert (
        "Determined no At least 3 answers fit the data equally well: the values below are those of one of"
        " them." in page.words
    )
    assert (
        "Near each of 3 answers that fit equally well, the data determine all of the 7 unknowns"
        in page.words
    )
    assert "group quantity this result answer 2 answer 3" in page.words
    # what differs most, in its standard deviations, comes first; what does not differ is left out
    first, second, third = (
        "bay 2 stiffness 0.720 1.302 0.720",
        "bay 5 mass 1.100 1.100 1.400",
        "bay 11 loss factor 0.022 0.072 0.022",
    )
    assert f"{first} {second} {third} odds of this result over it – 1.8 to 1 0.9 to 1" in page.words
    assert "sensor that distinguishes it from this result – 7:Z none" in page.words
    assert "typical difference of the FRFs there – 42 % –" in page.words


def test_of_one_answer_no_others_are_shown(page):
    assert "answers" not in page.words


def test_units_follow_the_kind_of_each_dof():
    start = Model.from_groups(
        {"hub": Group(stiffness=[[2e4, 1e4], [1e4, 2e4]], mass=np.eye(2), loss_factor=0.01)},
        ["1:Z", "1:RX"],
    )
    chosen = ParameterSet((Parameter("hub", "stiffness", 1.0, 0.5, 2.0),))
    frf = measured(start, n_lines=20, responses=["1:Z", "1:RX"], references=["1:Z", "1:-RX"])
    result = realistic(
        start=start, model=start, data=frf, lines=frf.freq, fitted_responses=("1:Z", "1:RX"), validation_responses=(),
        validation_band=None, parameters=chosen, values={"hub.stiffness": 1.0}, std={"hub.stiffness": 0.1},
        covariance=np.array([[0.01]]), at_bound={}, history=(),
    )  # fmt: skip
    assert embedded(render(result), "updyn-frf")["units"] == [
        ["(m/s²)/N", "(m/s²)/(N m)"],
        ["(rad/s²)/N", "(rad/s²)/(N m)"],
    ]


def test_text_of_the_user_is_never_markup():
    html = render(hostile())
    page = Page(html)
    assert page.open == []
    assert not page.of("img")
    assert not page.of("b")[1:]  # the overlay's own
    assert all(not name.startswith("on") for _, attrs in page.elements for name in attrs)
    plain, count = Page(render(realistic(title="plain"))), len(page.of("script"))
    assert count == len(plain.of("script"))
    assert HOSTILE in "".join(page.text)  # it is shown as it was written
    figures = embedded(html, "updyn-figures")
    ticks = figures["changes"]["layout"]["yaxis"]["ticktext"]
    assert "&lt;/script&gt;&lt;b onmouseover=alert(3)&gt;@after" in ticks


def test_outliers_are_named():
    told = {
        "kind": "stated",
        "relative": 0.02,
        "chi_square": 1.1,
        "robust": "student-t",
        "down_weighted": 0.034,
    }
    told |= {"down_weighted_lines": [50.0, 150.0], "down_weighted_channels": ["3:+Z / 2:+Z"]}
    words = Page(render(realistic(noise=told))).words
    assert "3.4 % of the values stand out and have less than a tenth of their weight." in words
    assert "at least half of the lines 50, 150 Hz and the channels 3:+Z / 2:+Z." in words
    assert (
        "No outliers: all values"
        in Page(render(realistic(noise=told | {"down_weighted": 0.0}))).words
    )


def test_smallest_case_says_what_is_missing():
    page = Page(render(smallest()))
    assert page.open == []
    for said in (
        "No iterations were recorded.",
        "Nothing was held out of the fit",
        "The method used no noise model.",
        "with one channel it is always 1",
        "The data determine the one unknown.",
        "FRAC, median",  # computed here, as the result has no figures
        "Only channel: response 1:Z, force 2:Z",
    ):
        assert said in page.words


def test_largest_case_is_thinned_and_says_so():
    html = render(largest(n_lines=700))
    assert len(html) < 25_000_000
    said = re.search(r"To keep this page small, (\d+) of 700 lines are drawn", html)
    drawn = int(said[1])
    frf = embedded(html, "updyn-frf")
    assert len(frf["measured"]) == 4 * math.ceil(drawn * 1000 * 8 / 3)
    assert len(frf["freq"]) == 4 * math.ceil(drawn * 8 / 3)
    assert "and 24 more with weights up to 1" in html


def test_a_model_that_cannot_be_solved_is_reported_not_raised():
    groups = {"bay 1": Group(stiffness=np.array([[1.0]]), mass=np.array([[1.0]]))}
    stuck = Model.from_groups(groups, ["1:Z"])
    base = smallest()
    at = 1.0 / (2 * np.pi)  # its undamped natural frequency
    frf = updyn.FRF([0.5 * at, at, 2 * at], np.ones((3, 1, 1)), ["1:Z"], ["1:Z"], "receptance")
    page = Page(
        render(
            dataclasses.replace(
                base, start=stuck, model=stuck, data=frf, lines=frf.freq, status="failed"
            )
        )
    )
    assert "The updated model could not be computed and is not drawn" in page.words
    assert "No agreement is available." in page.words


def test_written_whole_or_not_at_all(tmp_path):
    there = tmp_path / "report.html"
    there.write_text("old")
    written = updyn.write_report(realistic(), str(there))
    assert written == there
    assert there.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(FormatError, match="does not exist"):
        updyn.write_report(realistic(), tmp_path / "nowhere" / "report.html")


OUTSIDE = """from updyn.report.section import ReportSection


class Mounts(ReportSection):
    anchor, name, heading, place = "mounts", "Mounts", "Mounts <of> rubber", 450
    template = "outside/mounts.html"

    def figures(self, content):
        return {"mounts": {"data": [], "layout": {}, "height": 100}}

    def context(self, content):
        return {"mounts": content.further["mounts"], "title": content.result.title}


MOUNTS = Mounts()
"""
TEMPLATE = """{% from "updyn.report/macros.html" import figure with context %}
<p>{{ mounts | length }} {{ "<mounts>" }} at {{ title }}</p>
{{ figure("mounts", "Mounts") }}
"""


@pytest.fixture
def with_mounts(monkeypatch, tmp_path_factory):
    """A section of another package, with its template, registered by name."""
    folder = tmp_path_factory.mktemp("packages")
    (folder / "outside" / "templates").mkdir(parents=True)
    (folder / "outside" / "__init__.py").write_text(OUTSIDE)
    (folder / "outside" / "templates" / "mounts.html").write_text(TEMPLATE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(SECTIONS, "_entries", dict(SECTIONS._entries))
    SECTIONS.register("mounts.table", "outside:MOUNTS")
    yield
    sys.modules.pop("outside", None)


def test_a_section_from_outside_shows_its_object(with_mounts, tmp_path):
    path = updyn.write_report(realistic(), tmp_path / "report.html", mounts=[1, 2])
    html = path.read_text(encoding="utf-8")
    page = Page(html)
    assert page.open == []
    assert "Mounts <of> rubber 2 <mounts> at Mast, test 3" in page.words
    ids = [a["id"] for a in page.of("section")]
    assert ids[ids.index("mounts") - 1 : ids.index("mounts") + 2] == [
        "unknowns",
        "mounts",
        "identifiability",
    ]
    assert embedded(html, "updyn-figures")["mounts"]["height"] == 100
    assert 'id="mounts"' not in render(realistic())


def test_an_object_that_no_section_shows_is_refused(with_mounts, tmp_path):
    with pytest.raises(OptionError, match="did you mean 'mounts'"):
        updyn.write_report(realistic(), tmp_path / "report.html", mount=[1, 2])
    assert not list(tmp_path.iterdir())
