"""What the pages Data, Run and Result show, and what a click on it does."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace

import pytest

import updyn
from updyn.cli import main
from updyn.demos import find_demo
from window import browsing, serving, visit

pytest.importorskip("nicegui")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def window(chromium, tmp_path_factory):
    """The chain with a sensor that was mounted upside down; two runs of an earlier session."""
    folder = tmp_path_factory.mktemp("project")
    job = find_demo("chain").write_inputs(folder)
    text = job.read_text(encoding="utf-8")
    for name, method in (("first", "maximum-likelihood"), ("second", "output-error")):
        job.write_text(text.replace("maximum-likelihood", method), encoding="utf-8")
        main(["run", str(job), "--out", str(folder / name)])
    job.write_text(text, encoding="utf-8")
    frf = updyn.read_frf(folder / "chain.uff")
    values = frf.values.copy()
    values[:, frf.responses.labels.index("5:X")] *= -1.0
    (folder / "chain.uff").unlink()
    updyn.write_frf(replace(frf, values=values), folder / "chain.uff")
    with serving(folder, "job.toml") as server, browsing(chromium, server) as (page, heard):
        yield server, page, job
        assert heard.wrong == []


def wait_for_figures(page, n):
    """Wait until the page has exactly a number of drawn figures."""
    page.wait_for_function(f"() => document.querySelectorAll('.js-plotly-plot').length === {n}")


def wait_for_curves(page, n):
    """Wait until the first figure has a number of curves."""
    figure = "document.querySelector('.js-plotly-plot')"
    page.wait_for_function(f"() => {figure}?._fullData?.length === {n}")


def test_all_channels_are_shown_with_the_model_at_its_start(window):
    server, page, _ = window
    visit(page, f"{server.base}/measurement")
    wait_for_figures(page, 10)
    page.get_by_text(re.compile(r"model at its start differs .* by [\d.]+ dB")).wait_for()
    wait_for_curves(page, 2)
    page.get_by_text("model at the start", exact=True).click()
    wait_for_curves(page, 1)
    page.get_by_role("button", name="7:X / 12:X").click()
    page.get_by_role("combobox", name="response", exact=True).wait_for()
    assert page.get_by_role("combobox", name="response", exact=True).input_value() == "7:X"
    page.get_by_role("button", name="Next channel").click()
    page.wait_for_function(
        "() => document.querySelector('input[aria-label=response]').value === '10:X'"
    )
    page.get_by_text("phase", exact=True).click()
    wait_for_curves(page, 2)
    page.get_by_role("button", name="Map", exact=True).click()
    page.wait_for_selector(".heatmaplayer image")
    box = page.locator(".nsewdrag").first.bounding_box()
    page.mouse.click(box["x"] + 200, box["y"] + 0.95 * box["height"])
    page.wait_for_function(
        "() => document.querySelector('input[aria-label=response]')?.value === '12:X'"
    )


def test_figures_are_drawn_once_they_are_near_the_screen(window):
    """The page has its full length before; a figure that is far below is drawn when it is scrolled to."""
    server, page, _ = window
    size = page.viewport_size
    page.set_viewport_size({"width": 420, "height": 600})
    visit(page, f"{server.base}/measurement")
    page.wait_for_selector(".js-plotly-plot .main-svg")
    page.get_by_text(re.compile(r"model at its start differs")).wait_for()
    drawn = "document.querySelectorAll('.js-plotly-plot').length"
    assert page.evaluate(drawn) < 10
    length = page.evaluate("document.documentElement.scrollHeight")
    last = page.get_by_role("button", name="12:X / 12:X")
    last.scroll_into_view_if_needed()
    page.wait_for_function(
        "() => [...document.querySelectorAll('.js-plotly-plot')].at(-1).getBoundingClientRect().bottom"
        " > 0.9 * innerHeight"
    )
    assert page.evaluate("document.documentElement.scrollHeight") == pytest.approx(length, abs=40)
    page.set_viewport_size(size)


def test_a_finding_shows_the_effect_of_its_repair_and_can_be_left_out(window):
    server, page, job = window
    visit(page, f"{server.base}/measurement")
    page.get_by_role("button", name="Look for faults of the data").click()
    card = page.locator(".q-card").filter(has_text="Repair: sign:5:X")
    card.get_by_text(re.compile(r"at the start: \d+ % now, \d+ % after the repair")).wait_for()
    card.locator(".js-plotly-plot").wait_for()
    card.get_by_role("button", name="Leave out 5:X").click()
    page.get_by_text("job.toml (edited)").wait_for()
    wait_for_figures(page, 8)
    page.get_by_text("No fault was found in these data.").wait_for()
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("job.toml", exact=True).wait_for()
    assert "responses" not in tomllib.loads(job.read_text(encoding="utf-8"))["test"]


def test_results_of_an_earlier_session_are_found_and_compared(window):
    server, page, _ = window
    visit(page, f"{server.base}/run")
    page.get_by_text("Latest run: second, usable").wait_for()
    page.get_by_text(re.compile("^Level error .* in the end")).wait_for()
    wait_for_figures(page, 2)
    page.get_by_role("link", name="Results").last.click()
    page.get_by_text("Report of second in a separate tab").wait_for()
    page.get_by_role("row", name="first").get_by_role("checkbox").click()
    page.get_by_role("cell", name="≠ method.name").wait_for()
    assert page.get_by_role("cell", name="resembles").count() == 0
    page.get_by_text("only differences").click()
    page.get_by_role("cell", name="resembles").wait_for()
    wait_for_figures(page, 2)
    page.wait_for_function(
        "() => document.querySelectorAll('.js-plotly-plot')[1]._fullData?.length === 3"
    )
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280


def test_a_check_is_a_task_of_the_window(window):
    server, page, _ = window
    visit(page, f"{server.base}/check")
    page.get_by_role("button", name="Save and begin").click()
    done = page.get_by_role("status").filter(has_text=re.compile("^Ended: 12 of 12 unknowns"))
    done.wait_for()
    heading = page.frame_locator("iframe").get_by_role("heading", name="Chain of twelve masses")
    heading.wait_for()


def begin(page, place):
    visit(page, place)
    page.get_by_role("button", name="Save and begin").click()


def wait_for_state(page, pattern):
    state = page.get_by_role("status").filter(has_text=re.compile(pattern))
    state.wait_for()
    return state.inner_text()


def test_model_and_measurement_are_compared_at_the_start(window):
    server, page, _ = window
    begin(page, f"{server.base}/correlate")
    wait_for_state(page, "^Ended: 12 of 12 unknowns")
    written = page.frame_locator("iframe")
    written.get_by_role("heading", name="Chain of twelve masses").wait_for()
    written.get_by_text(re.compile(r"^\d of \d modes of the test are paired\.$")).first.wait_for()


def test_methods_are_compared_up_to_a_stop(window):
    """It can be stopped from any tab; the methods that have ended are on the page."""
    server, page, _ = window
    begin(page, f"{server.base}/compare")
    wait_for_state(page, r"^(Running: [a-z-]+ \(([2-9]|1\d) of|Ended)")
    page.get_by_role("button", name="Stop").click()
    wait_for_state(page, "^Ended")
    written = page.frame_locator("iframe")
    written.get_by_role("cell", name="maximum-likelihood").or_(
        written.get_by_role("rowheader", name="maximum-likelihood")
    ).first.wait_for()
    assert re.search(r"of \d+ methods? can be used", written.locator("header").inner_text())


@pytest.mark.parametrize("task", ["correlate", "compare"])
def test_a_task_whose_input_is_gone_says_so(window, task):
    server, page, job = window
    data = job.with_name("chain.uff")
    data.rename(job.with_name("gone"))
    try:
        begin(page, f"{server.base}/{task}")
        wait_for_state(page, "^(Failed|Ended: failed)")
        page.get_by_text(re.compile("chain.uff.*no such file")).first.wait_for()
    finally:
        job.with_name("gone").rename(data)
