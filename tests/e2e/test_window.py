"""The window of `updyn serve` in a real browser, from the measured beam to the same numbers by command."""

from __future__ import annotations

import itertools
import json
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from updyn.cli import main
from updyn.demos import chain, find_demo
from updyn.dofs import DofSet
from updyn.io import write_frf
from updyn.style import DARK, PAPER
from window import browsing, serving

pytest.importorskip("nicegui")
expect = pytest.importorskip("playwright.sync_api").expect
pytestmark = [
    pytest.mark.needs("browser"),
    # sockets and pipes of the driver of the browser, when it ends
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def chart(page):
    """The box within the axes of the first figure, once it is drawn."""
    return page.locator(".nsewdrag").first.bounding_box()


def frequency(page, x):
    """The frequency in Hz at a distance in px from the left of the axes of the first figure."""
    axis = "document.querySelector('.js-plotly-plot')._fullLayout.xaxis"
    return page.evaluate(f"(x) => {axis}.p2c(x)", x)


def wait_for_ink(page, colour):
    """Wait until the measured points of the first figure have a colour of the form ``#rrggbb``."""
    rgb = f"rgb({', '.join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))})"
    ink = "getComputedStyle(document.querySelector('.point')).fill"
    page.wait_for_function(f"(rgb) => {ink} === rgb", arg=rgb)


def drag(page, box, start, end):
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + start, y)
    page.mouse.down()
    for x in (start + (end - start) / 2, end):
        page.mouse.move(box["x"] + x, y, steps=5)
    page.mouse.up()


def state(page, pattern):
    """Wait until the state of the task is as said; return it."""
    place = page.get_by_role("status").filter(has_text=re.compile(pattern))
    place.wait_for()
    return place.inner_text()


def test_from_the_measured_beam_to_the_same_numbers_by_command(chromium, tmp_path):
    with serving(tmp_path) as server, browsing(chromium, server) as (page, heard):
        page.get_by_role("button", name="Open beam").click()
        page.wait_for_url("**/measurement")
        job = tmp_path / "beam" / "job.toml"
        before = job.read_text(encoding="utf-8")

        # the band by dragging, narrow enough for a short run; a line by a click
        page.get_by_role("button", name="One channel").click()
        page.get_by_text("phase", exact=True).wait_for()
        box = chart(page)
        drag(page, box, 40, 110)
        page.get_by_text("beam/job.toml (edited)").wait_for()
        used = page.get_by_text(re.compile(r"^\d+ of 4999 lines are used"))
        used.filter(has_not_text="4400 of").wait_for()
        lines = used.inner_text().split()[0]
        page.get_by_text("Drag or click leaves lines out").click()
        box = chart(page)
        page.mouse.click(box["x"] + 75, box["y"] + box["height"] / 2)
        page.get_by_text(re.compile(rf"^{int(lines) - 1} of 4999 lines are used")).wait_for()
        page.get_by_role("button", name="Undo").click()
        page.get_by_role("button", name="Redo").click()

        # the unknowns in the table; what the data determine is told anew
        page.goto(f"{server.base}/unknowns")
        page.get_by_text(re.compile("could determine (all 6 unknowns|. of 6)")).wait_for()
        page.get_by_role("checkbox", name="accelerometers mass").click()
        page.get_by_text(re.compile("could determine (all 5 unknowns|. of 5)")).wait_for()

        # run, watch, stop, resume
        page.goto(f"{server.base}/run")
        folder = page.get_by_label("Folder for the results")
        folder.wait_for()
        folder.fill("beam/first")
        stop = page.get_by_role("button", name="Stop")
        expect(stop).to_be_disabled()
        page.get_by_role("button", name="Save and run").click()
        state(page, "^Running: .* steps?")
        expect(page.get_by_role("button", name="Save and run")).to_be_disabled()
        stop.click()
        assert state(page, "^Ended") == "Ended: stopped"
        page.get_by_role("button", name="Resume").click()
        status = state(page, "^Ended: (?!stopped)").removeprefix("Ended: ")

        # the same by command, side by side
        main(["run", str(job), "--out", str(tmp_path / "beam" / "command")])
        page.goto(f"{server.base}/results")
        page.get_by_text("Report of beam/command in a separate tab").wait_for()
        page.frame_locator("iframe").get_by_role("heading", name="Steel beam, whole").wait_for()
        page.get_by_role("row", name="beam/first").get_by_role("checkbox").click()
        page.get_by_role("columnheader", name="beam/first").wait_for()
        assert heard.wrong == []

    # what was done by hand stands in the job, with its comments
    text = job.read_text(encoding="utf-8")
    assert [line for line in before.splitlines() if line.startswith("#")] == [
        line for line in text.splitlines() if line.startswith("#")
    ]
    written = tomllib.loads(text)
    assert (
        written["test"]["band"][0] < written["test"]["exclude"][0][0] < written["test"]["band"][1]
    )

    def values(name):
        record = json.loads((tmp_path / "beam" / name / "result.json").read_text(encoding="utf-8"))
        return record["status"], {p["name"]: p["value"] for p in record["parameters"]}

    assert values("first") == values("command")
    assert values("command")[0] == status
    assert len(values("command")[1]) == 5


def test_band_and_excluded_lines_are_those_picked_in_the_figure(chromium, tmp_path):
    chain.write_inputs(tmp_path)
    freq = chain.measure().freq
    with serving(tmp_path, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/measurement")
        page.get_by_role("button", name="One channel").click()
        page.get_by_text("phase", exact=True).wait_for()
        box = chart(page)
        wait_for_ink(page, PAPER["measured"])
        page.emulate_media(color_scheme="dark")
        wait_for_ink(page, DARK["measured"])

        def wait_for_lines(n):
            page.get_by_text(re.compile(rf"^{n} of {len(freq)} lines are used")).wait_for()

        low, high = frequency(page, 200), frequency(page, 800)
        inside = freq[(freq >= low) & (freq <= high)]
        drag(page, box, 200, 800)
        wait_for_lines(len(inside))
        page.mouse.click(box["x"] + 500, box["y"] + 20)  # selects nothing in this mode
        page.get_by_text("Drag or click leaves lines out").click()
        near = np.argmin(np.abs(freq - frequency(page, 500)))
        page.mouse.click(box["x"] + 500, box["y"] + 20)
        wait_for_lines(len(inside) - 1)
        left, right = frequency(page, 300), frequency(page, 400)
        box = chart(page)
        drag(page, box, 400, 300)
        n = np.count_nonzero((freq >= left) & (freq <= right))
        wait_for_lines(len(inside) - 1 - n)
        page.get_by_role("button", name="Save").click()
        page.get_by_text("job.toml", exact=True).wait_for()
        assert heard.wrong == []
    test = tomllib.loads((tmp_path / "job.toml").read_text(encoding="utf-8"))["test"]

    def taken(band):
        return freq[(freq >= band[0]) & (freq <= band[1])].tolist()

    assert taken(test["band"]) == inside.tolist()
    excluded = sorted(line for band in test["exclude"] for line in taken(band))
    assert excluded == sorted([*taken((left, right)), freq[near]])


def fill(page, label, text, delay):
    """Replace an entry by keys, at once or with a pause in ms after each."""
    page.get_by_label(label).click()
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")
    page.keyboard.type(text, delay=delay)


def step(page, name, state):
    """Wait until the icon of a step shows its state."""
    icons = {"done": "check_circle", "warning": "warning", "open": "radio_button_unchecked"}
    link = page.get_by_role("link", name=re.compile(f"^{name}: "))
    link.locator("i").filter(has_text=icons[state]).wait_for()


def test_from_two_dropped_files_to_a_repaired_and_repeated_job(chromium, tmp_path):
    """Typed at the speed of a machine, then of a person; a sensor was mounted upside down."""
    given, project = tmp_path / "given", tmp_path / "project"
    given.mkdir()
    project.mkdir()
    find_demo("chain").write_inputs(given)
    data = chain.measure()
    values = data.values.copy()
    values[:, data.responses.labels.index("5:X")] *= -1.0
    (given / "chain.uff").unlink()
    write_frf(replace(data, values=values), given / "chain.uff")
    with serving(project) as server, browsing(chromium, server) as (page, heard):
        page.set_input_files("input[multiple]", [given / "chain.h5", given / "chain.uff"])
        page.get_by_text("chain.h5: model").wait_for()
        page.get_by_text("chain.uff: measurement").wait_for()
        create = page.get_by_role("button", name="Create the job")
        fill(page, "Name of the job", "", 0)
        page.locator(".q-field", has_text="Name of the job").get_by_text("required").wait_for()
        assert create.is_disabled()
        fill(page, "Name of the job", "mine.toml", 0)
        create.click()
        page.wait_for_url("**/measurement")
        job = project / "mine.toml"
        before = job.read_text(encoding="utf-8")
        for name in ("Sensors", "Unknowns"):
            step(page, name, "done")
        assert page.title().startswith("Data – ")

        # a model that cannot be drawn has no picture
        page.get_by_role("link", name="Next: Sensors").click()
        page.get_by_text("it cannot be drawn").wait_for()
        page.get_by_role("link", name="Next: Unknowns").click()
        page.get_by_text(re.compile("could determine")).wait_for()
        assert page.locator("iframe").count() == 0
        for number in (1, 2, 3, 4):
            page.get_by_role("checkbox", name=f"part{number} mass").click()
        page.get_by_text("could determine all 12 unknowns").wait_for()

        step(page, "Check", "open")
        page.get_by_role("link", name="Next: Check").click()
        step(page, "Check", "warning")
        page.get_by_role("button", name="Repair: sign:5:X").click()
        page.get_by_text("No known fault was found in the data.").wait_for()
        step(page, "Check", "done")
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_text("mine.toml", exact=True).wait_for()
        written = tomllib.loads(job.read_text(encoding="utf-8"))
        assert written["test"]["repair"] == ["sign:5:X"]
        masses = next(each for each in written["parameter"] if each["quantity"] == "mass")
        assert masses["bounds"] == [0.5, 2.0]  # as a new job has them
        assert "repair" not in before

        step(page, "Result", "open")
        for name, delay in (("first", 0), ("second", 60)):
            page.goto(f"{server.base}/run")  # typed as soon as the page takes it
            fill(page, "Folder for the results", name, delay)
            page.get_by_role("button", name="Save and run").click()
            active = page.get_by_role("link").filter(has_text="mine.toml: Running")
            active.wait_for()
            if name == "first":
                page.goto(server.base)  # seen from every page
                active.click()
                page.wait_for_url("**/run")
            active.wait_for(state="hidden")  # else the state may be that of the run before
            assert state(page, "^Ended") == "Ended: converged"
        step(page, "Result", "done")
        assert heard.wrong == []

    def values_of(name):
        record = json.loads((project / name / "result.json").read_text(encoding="utf-8"))
        return {p["name"]: p["value"] for p in record["parameters"]}

    assert values_of("first") == values_of("second")
    assert values_of("first")["part1.stiffness"] == pytest.approx(0.8, rel=0.01)


def test_what_is_held_out_is_shown_and_written_as_the_model_labels_it(chromium, tmp_path):
    """Of a test that numbers its sensors otherwise; without a change the file stays as it is."""
    chain.write_inputs(tmp_path)
    data = chain.measure()
    numbers = {label: f"{n}:X" for n, label in enumerate(data.responses.labels, 1)}
    sides = {
        side: DofSet(numbers[label] for label in getattr(data, side).labels)
        for side in ("responses", "references")
    }
    write_frf(replace(data, **sides), tmp_path / "own.uff")
    table = "".join(f'"{new}" = "{old}"\n' for old, new in numbers.items())
    job = tmp_path / "own.toml"
    job.write_text(
        '[model]\nfile = "chain.h5"\n[test]\nfile = "own.uff"\n[match.table]\n'
        f'{table}[[parameter]]\ngroups = "part*"\nquantity = "stiffness"\n'
        '[method]\nvalidation = ["7:X"]\n',
        encoding="utf-8",
    )
    before = job.read_text(encoding="utf-8")
    with serving(tmp_path, "own.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/measurement")
        held = page.locator(".q-field", has_text="responses held out of the fit")
        held.get_by_text("7:X (sensor 3:X)").wait_for()
        page.get_by_text("own.toml", exact=True).wait_for()
        held.get_by_role("combobox").click()
        page.get_by_role("option", name="10:X (sensor 4:X)").click()
        page.get_by_text("own.toml (edited)").wait_for()
        held.get_by_text("10:X (sensor 4:X)").wait_for()
        page.get_by_role("button", name="Save").click()
        page.get_by_text("own.toml", exact=True).wait_for()
        assert heard.wrong == []
    expected = before.replace('["7:X"]', '["7:X", "10:X"]')
    assert job.read_text(encoding="utf-8") == expected
    assert main(["check", str(job), "--out", str(tmp_path / "checked")]) == 0


def check_layout(server, page, width, *, is_below):
    page.goto(f"{server.base}/model")
    page.get_by_role("columnheader", name="distance (m)").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.goto(f"{server.base}/unknowns")
    page.get_by_text(re.compile("could determine")).wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    picture = page.get_by_title("Structure").bounding_box()
    choices = page.get_by_role("checkbox", name="beam stiffness").bounding_box()
    assert (choices["y"] > picture["y"] + picture["height"]) == is_below
    assert picture["width"] >= (0.85 if is_below else 0.4) * width
    headings = [page.get_by_text(name, exact=True) for name in ("group", "stiffness", "mass")]
    boxes = [heading.bounding_box() for heading in headings]
    for left, right in itertools.pairwise(boxes):
        assert left["x"] + left["width"] <= right["x"]


def test_pages_fit_a_narrow_screen(chromium, tmp_path):
    """Nothing scrolls sideways; picture and choices are side by side only where there is room."""
    with serving(tmp_path) as server, browsing(chromium, server, 420) as (page, heard):
        page.get_by_role("button", name="Open beam").click()
        page.wait_for_url("**/measurement")
        check_layout(server, page, 420, is_below=True)
        page.set_viewport_size({"width": 1280, "height": 1000})
        check_layout(server, page, 1280, is_below=False)
        assert heard.wrong == []
