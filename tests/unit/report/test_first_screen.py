"""The first screen of a report: what it says is true, in few words, and fits on the screen."""

from __future__ import annotations

import dataclasses
import re
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from page_waits import wait_for
from pages_read import Page
from pages_read import values as plotted
from programs import program
from report_case import realistic
from updyn.demos import chain
from updyn.remedy import Remedy
from updyn.report.changes import largest_changes
from updyn.report.channels import small_curves, worst_and_median
from updyn.report.evidence import _describe_channel, show_evidence
from updyn.report.formats import paragraphs, split_more
from updyn.report.page import render
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST, REPORT_SIZE
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.claim import Claim

CASES = ("usable", "not-predicted", "swapped", "open", "several-remarks")


def fit(frf, **unknowns):
    model = chain.build()
    chosen = updyn.parameters(model, stiffness="all", loss_factor="all", **unknowns)
    return updyn.update(model, frf, chosen, validation=["7:X"])


def exchange_sensors(good):
    """The result of data with two exchanged sensors, as a fit reports it."""
    fault = read_fault("swapped:5:X,2:X")
    statement = "5:X and 2:X are exchanged."
    finding = Finding("swapped", ("5:X", "2:X"), 0.0, 1e9, 0.9, statement, fault.remedy, fault.repair_text)  # fmt: skip
    held_out = "A held-out channel has a correlation of -0.30 with the model's."
    message = f"The fit converged, but its result is not credible. {held_out} {statement}"
    trust = dataclasses.replace(
        good.trust, plausible=Claim(False, statement), validated=Claim(False, held_out)
    )
    return dataclasses.replace(
        good, status="not-credible", message=message, steps=(fault.remedy,), trust=trust,
        findings=(finding,),
    )  # fmt: skip


@pytest.fixture(scope="module")
def results():
    """A good fit, wrong held masses, two exchanged sensors, an open combination, many remarks."""
    frf = chain.measure()
    good = fit(frf, mass="all")
    many = " ".join(f"Remark {i} on the fit." for i in range(7))
    more = "The model cannot explain channel 1 near 2 Hz; and 282 more channels or bands."
    finding = Finding("missing-mode", (), 9.1, 1e9, 0.2, "A measured mode at 9.1 Hz is not in the model.", Remedy("Do it."), "missing-mode=9.1")  # fmt: skip
    plausible = good.trust.plausible.add(finding.statement)
    return {
        "usable": good,
        "not-predicted": fit(frf),
        "swapped": exchange_sensors(good),
        "open": realistic(),
        "several-remarks": dataclasses.replace(
            good,
            message=f"{good.message} {many} {more} {finding.statement}",
            steps=(Remedy.repair(f"{many} Write:", finding.written), Remedy("Then do that.")),
            trust=dataclasses.replace(good.trust, plausible=plausible),
            findings=(finding,),
        ),
    }


@pytest.fixture(scope="module")
def pages(results):
    return {name: render(result) for name, result in results.items()}


def top(html):
    """The header of a page, which is its first screen."""
    return re.search("<header>.*?</header>", html, re.DOTALL)[0]


def lines_to_paste(html):
    return Page(re.search("<pre.*?</pre>", top(html), re.DOTALL)[0]).words.strip()


@pytest.mark.parametrize("case", CASES)
def test_no_paragraph_has_more_than_two_sentences(pages, case):
    texts = [Page(text).words for text in re.findall("<p[ >].*?</p>", top(pages[case]), re.DOTALL)]
    assert len(texts) > 5
    assert max(len(re.findall(r"[.!?]( (?=[A-Z0-9])|$)", text.strip())) for text in texts) <= 2


@pytest.mark.parametrize(
    ("case", "badge", "colour", "failing", "lines"),
    [
        ("usable", "Usable", "good", [], 'model = updyn.read_model("model.h5")'),
        ("swapped", "Not credible", "bad", ["Plausible no"], 'repair = ["swapped:5:X,2:X"]'),
        ("open", "Not all unknowns determined", "warn", ["Determined no"], "[plan]"),
        ("several-remarks", "Usable", "good", [], 'repair = ["missing-mode=9.1"]'),
    ],
)
def test_what_the_screen_says_is_true(pages, case, badge, colour, failing, lines):
    words = Page(top(pages[case])).words
    assert f'<p class="verdict {colour}">{badge}</p>' in pages[case]
    for mark in failing:
        assert f"✗ {mark}" in words
    assert ("✗" in words) == bool(failing)
    assert lines_to_paste(pages[case]).startswith(lines)


def test_held_masses_that_are_wrong_are_the_next_step(pages, results):
    """The masses of the chain are wrong and held: the fit is red, and the step frees one of them."""
    assert '<p class="verdict bad">' in pages["not-predicted"]
    assert "✗ Validated no" in Page(top(pages["not-predicted"])).words
    step = lines_to_paste(pages["not-predicted"])
    assert step.startswith("[[parameter]] groups =")
    assert step.endswith('quantity = "mass"')


@pytest.mark.parametrize("case", CASES)
def test_the_marks_that_decide_show_their_sentence(pages, results, case):
    """What rules a result out is shown alone; without such a part, all parts that fail are."""
    pattern = r'<details class="mark (\w+)"( open)?><summary.*?</span> (\w+) '
    marks = re.findall(pattern, top(pages[case]), re.DOTALL)
    trust = results[case].trust
    assert len(marks) == (5 if trust else 2)
    unfolded = [name for _, is_open, name in marks if is_open]
    failing = [name for kind, _, name in marks if kind in ("bad", "warn")]
    decisive = {"swapped": ["Plausible"], "not-predicted": unfolded[:1]}
    assert unfolded == decisive.get(case, failing)
    assert set(unfolded) <= set(failing)
    if trust:
        fails = sum(claim.asked and claim.holds is not True for claim in trust.values())
        assert len(failing) == fails


def test_a_finding_limits_the_verdict_and_is_not_its_reason(pages):
    html = top(pages["several-remarks"])
    (said,) = re.findall('<p class="reservation">(.*?)</p>', html)
    assert said == "But: A measured mode at 9.1 Hz is not in the model."
    (mark,) = re.findall(r"Plausible <span.*?</details>", html, re.DOTALL)
    assert "9.1 Hz" not in mark
    assert "reservation" not in top(pages["usable"])


def test_the_number_of_further_places_leads_to_the_section(pages):
    link = '<a href="#residual">and 282 more channels or bands</a>'
    assert link in top(pages["several-remarks"])


def test_paragraphs_and_the_further_places_of_a_text():
    assert paragraphs("A is 1. B is 2. C.") == ["A is 1. B is 2.", "C."]
    assert paragraphs("") == []
    text = "x; and 3 more channels or bands. Then"
    assert split_more(text) == ("x; ", "and 3 more channels or bands", ". Then")
    assert split_more("plain") == ("plain", "", "")


def test_the_largest_changes_are_those_of_the_result(results):
    result = results["usable"]
    figure = largest_changes(result)
    ratios = {p.name: result.values[p.name] / p.start for p in result.parameters}
    largest = sorted(ratios, key=lambda name: -abs(np.log(ratios[name])))
    expected = largest[: REPORT_LIST.largest_changes]
    estimates = [trace for trace in figure["data"] if trace.get("error_x")]
    found = {}
    for trace in estimates:
        error = trace["error_x"]
        for at, x, minus, plus in zip(trace["y"], *(plotted(part) for part in (trace["x"], error["arrayminus"], error["array"])), strict=True):  # fmt: skip
            found[int(at)] = (x, x - minus, x + plus)
    spans = result.intervals()
    for place, name in enumerate(
        expected
    ):  # all changed significantly: truth is far from the start
        start = next(p.start for p in result.parameters if p.name == name)
        low, high = (bound / start for bound in spans[name])
        np.testing.assert_allclose(found[place], (ratios[name], low, high), rtol=1e-6)
    bars = [trace for trace in figure["data"] if trace["mode"] == "lines"]
    ends = {
        int(y): x for trace in bars for x, y in zip(trace["x"][1::3], trace["y"][1::3], strict=True)
    }
    assert ends == pytest.approx({place: found[place][0] for place in found})


def test_several_tests_show_their_worst_channels(results):
    """Each with a link to its own report, and the verdict of each further section."""
    update = updyn.JointResult(
        {"rotor <held>": results["usable"], "free": results["not-predicted"]}
    )
    content = PageContent(update)
    evidence = show_evidence(content)
    first, second, changes = evidence.panels
    assert (first.heading, first.target) == (
        "Rotor <held>, worst channel",
        "rotor%20%3Cheld%3E/report.html#channels",
    )
    assert (second.heading, second.target) == (
        "Free, worst channel",
        "free/report.html#channels",
    )
    assert changes.target == "#changes"
    data = PageContent(results["not-predicted"]).data
    worst = worst_and_median(data)["worst"]
    assert second.caption.startswith(f"{data.responses[worst[0]]} / {data.references[worst[1]]}")
    html = top(render(update))
    assert 'href="free/report.html#channels"' in html
    assert "headline" not in html


def test_the_unit_of_a_residual_is_written_once():
    for before, after, text in (
        (2.3, 1.22, "230 → 122 %"),
        (347.0, 184.0, "347 → 184 times"),
        (160.0, 0.45, "160 times → 45 %"),
    ):
        data = SimpleNamespace(
            residual_before=np.array([[before]]), residual_after=np.array([[after]]),
            responses=["1:X"], references=["2:X"], held_out=[False], noise=None,
        )  # fmt: skip
        assert _describe_channel(data, (0, 0)) == f"1:X / 2:X: residual {text}"


def test_small_curves_keep_the_peaks(results):
    data = PageContent(results["usable"]).data
    worst = worst_and_median(data)["worst"]
    assert data.residual_after[worst] == data.residual_after.max()
    figure = small_curves(data, *worst)
    assert figure["layout"]["yaxis"]["title"]["text"] == "(m/s²)/N"
    measured, start, updated = figure["data"]
    assert plotted(measured["y"]).max() == pytest.approx(np.abs(data.measured[:, *worst]).max())
    for trace, curve in ((start, data.before_curve), (updated, data.after_curve)):
        assert plotted(trace["y"]).max() == pytest.approx(np.abs(curve[:, *worst]).max(), rel=1e-6)
        assert len(plotted(trace["x"])) <= REPORT_SIZE.small_curve_lines + 2


def test_grey_bars_are_explained_where_there_are_any(results):
    """Of the chain all unknowns have changed; with ten times the errors none has significantly."""
    good = results["usable"]
    vague = dataclasses.replace(good, std=dict.fromkeys(good.std, 10.0))
    captions = [
        panel.caption
        for result in (good, vague)
        for panel in show_evidence(PageContent(result)).panels
        if panel.name == "overview-changes"
    ]
    assert captions == [
        "From the start, with 95 % intervals.",
        "From the start, with 95 % intervals; grey: not significant.",
    ]


def test_a_fit_of_modes_shows_its_modes(results):
    model = chain.build()
    modes = updyn.modes(model.scaled({"part1": {"stiffness": 1.2}}), 4)
    measured = updyn.ModeSet(modes.frequency, modes.at(["2:X", "7:X", "12:X"]), ["2:X", "7:X", "12:X"])  # fmt: skip
    unknowns = updyn.parameters(model, stiffness=["part1"])
    html = render(updyn.update(model, measured, unknowns))
    for name in ("overview-modes-start", "overview-modes-updated"):
        assert f'data-figure="{name}"' in top(html)
    assert "4 of 4 modes of the test are paired." in Page(top(html)).words


# -- in a browser --------------------------------------------------------------------------------
MEASURE = """() => {
  const box = (element) => {
    const { left, top, right, bottom, width, height } = element.getBoundingClientRect();
    return { left, top, right, bottom, width, height };
  };
  const parts = {};
  for (const id of ["verdict", "next-step", "evidence"]) parts[id] = box(document.getElementById(id));
  parts.further = box(document.querySelector(".further"));
  parts.paste = box(document.getElementById("next-lines"));
  for (const place of document.querySelectorAll("#evidence [data-figure]")) parts[place.dataset.figure] = box(place);
  return { parts, over: document.documentElement.scrollWidth, errors: document.documentElement.dataset.errors ?? "" };
}"""
DRAWN = "() => [...document.querySelectorAll('#evidence [data-figure]')].every((one) => one.querySelector('.main-svg'))"
COPIED = """async () => {
  const said = document.querySelector("[data-copied]");
  document.querySelector("[data-copy]").click();
  while (!said.textContent) await new Promise((done) => setTimeout(done, 10));
  return [said.textContent.trim(), String(getSelection()), said.getAttribute("role")];
}"""


@pytest.fixture(scope="module")
def screens(pages, tmp_path_factory):
    """The boxes of the parts of each page by width, and what copying does."""
    sync_api = pytest.importorskip("playwright.sync_api")
    folder, out = tmp_path_factory.mktemp("screens"), {}
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program("browser"), args=["--no-sandbox"]
        )
        for name, html in pages.items():
            path = folder / f"{name}.html"
            path.write_text(html, encoding="utf-8")
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.set_default_timeout(60_000)
            page.goto(path.as_uri())
            wait_for(page, DRAWN)
            out[name, "copied"] = page.evaluate(COPIED)
            for width in (1280, 400, 1920):
                page.set_viewport_size({"width": width, "height": 800})
                out[name, width] = page.evaluate(MEASURE)
            page.close()
        browser.close()
    return out


@pytest.mark.needs("browser")
@pytest.mark.parametrize("case", CASES)
def test_it_fits_at_1280_by_800(screens, case):
    found = screens[case, 1280]
    assert found["errors"] == ""
    for name, box in found["parts"].items():
        assert box["bottom"] <= 800, name
        assert box["right"] <= 1280, name
        assert box["width"] > 100, name
    assert found["parts"]["evidence"]["left"] > found["parts"]["verdict"]["right"]
    assert found["parts"]["overview-worst"]["left"] < found["parts"]["overview-median"]["left"]


@pytest.mark.needs("browser")
@pytest.mark.parametrize("case", CASES)
def test_at_400_it_stacks_in_the_order_of_reading(screens, case):
    found = screens[case, 400]
    assert found["over"] <= 400
    order = ("verdict", "next-step", "further", "overview-worst", "overview-median", "overview-changes")  # fmt: skip
    boxes = [found["parts"][name] for name in order]
    for above, below in pairwise(boxes):
        assert above["bottom"] <= below["top"] + 1
    assert all(box["right"] <= 400 for box in boxes)


@pytest.mark.needs("browser")
def test_a_wide_screen_is_used(screens):
    wide, usual = (screens["usable", width]["parts"] for width in (1920, 1280))
    assert wide["overview-worst"]["width"] > 1.4 * usual["overview-worst"]["width"]
    assert wide["evidence"]["right"] - wide["verdict"]["left"] > 1400


@pytest.mark.needs("browser")
@pytest.mark.parametrize("case", CASES)
def test_the_lines_are_copied_or_selected(screens, pages, case):
    said, selected, role = screens[case, "copied"]
    assert said in ("Copied.", "Selected; copy with Ctrl+C.")
    assert " ".join(selected.split()) == lines_to_paste(pages[case])
    assert role == "status"
