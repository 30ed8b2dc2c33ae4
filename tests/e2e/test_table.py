"""A measurement in a layout that no format has: from the dropped file to a checked job."""

from __future__ import annotations

import tomllib

import pytest

from updyn.cli import main
from updyn.demos import chain, find_demo
from window import PATIENCE, browsing, choose, serving

pytest.importorskip("nicegui")
expect = pytest.importorskip("playwright.sync_api").expect
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def foreign_text(channels=("Real", "Imag")):
    """Two responses of the chain to one force, below a preamble; no name states a label."""
    frf = chain.measure()
    heads = ["Frequency [Hz]", *(f"{name} {n}" for n in (1, 2) for name in channels)]
    rows = [
        ";".join(f"{number!r}" for number in (f, a.real, a.imag, b.real, b.imag))
        for f, (a, b) in zip(frf.freq.tolist(), frf.values[:, :2, 0].tolist(), strict=True)
    ]
    return "\n".join(["Analyser; 4.2", ";".join(heads), *rows, ""])


def test_from_a_dropped_file_of_any_layout_to_a_checked_job(chromium, tmp_path):
    given, project = tmp_path / "given", tmp_path / "project"
    given.mkdir()
    project.mkdir()
    find_demo("chain").write_inputs(given)
    (given / "hit.csv").write_text(foreign_text(), encoding="utf-8")
    with serving(project) as server, browsing(chromium, server) as (page, heard):
        page.set_input_files("input[multiple]", [given / "chain.h5", given / "hit.csv"])
        page.get_by_text("chain.h5: model").wait_for()
        page.get_by_text("hit.csv: measurement").wait_for()
        assert page.get_by_role("button", name="Create the job").is_disabled()
        page.get_by_role("button", name="Select the FRFs").click()
        page.wait_for_url("**/table")

        # the proposal is drawn before the labels are known, and nothing can be used yet
        page.locator(".js-plotly-plot").wait_for()
        assert page.locator(".js-plotly-plot").bounding_box()["height"] == 260
        preview = page.locator(".q-card", has_text="As they are read").locator("tbody tr")
        assert preview.count() == 5
        page.get_by_text("To fill in: measured quantity, response, reference.").wait_for()
        use = page.get_by_role("button", name="Use these columns")
        assert use.is_disabled()
        for number, label in enumerate(("2:X", "5")):
            page.get_by_label("response *").nth(number).fill(label)
        page.get_by_label("reference *").first.fill("2:X")
        page.get_by_text("'5'; expected a node and a direction").first.wait_for()
        repeat = page.get_by_role("button", name="Use the first reference for all")
        box = repeat.bounding_box()
        page.get_by_label("response *").nth(1).fill("5:X")
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.get_by_text("'5'; expected a node and a direction").first.wait_for(state="hidden")
        assert repeat.bounding_box()["y"] < box["y"] - box["height"] / 2  # and is clicked still
        page.mouse.up()
        expect(page.get_by_label("reference *").nth(1)).to_have_value("2:X", timeout=PATIENCE)
        page.get_by_role("button", name="Add a channel").hover()
        page.mouse.down()
        page.mouse.move(0, 0)  # away from it: no click
        page.mouse.up()
        choose(page, "measured quantity", "accelerance")
        page.get_by_text("2 responses, 1 reference, 60 lines").wait_for()
        assert sorted(path.name for path in project.iterdir()) == ["chain.h5", "hit.csv"]
        use.click()

        page.get_by_text("2 responses, 1 reference, 60 lines").wait_for()
        page.get_by_role("button", name="Create the job").click()
        page.wait_for_url("**/measurement")
        page.goto(f"{server.base}/job")
        page.get_by_text("Nothing is wrong with the job.").wait_for()
        assert heard.wrong == []
    assert main(["check", str(project / "job.toml"), "--out", str(tmp_path / "checked")]) == 0
    columns = tomllib.loads((project / "job.toml").read_text(encoding="utf-8"))["test"]["columns"]
    assert columns["channels"][1] == {
        "response": "5:X", "reference": "2:X", "real": "Real 2", "imaginary": "Imag 2",
    }  # fmt: skip


def test_the_columns_of_an_open_job_are_selected_on_a_narrow_screen(chromium, tmp_path):
    job = find_demo("chain").write_inputs(tmp_path)
    (tmp_path / "hit.txt").write_text(foreign_text(("a", "b")), encoding="utf-8")
    text = job.read_text(encoding="utf-8").replace("chain.uff", "hit.txt")
    job.write_text(text, encoding="utf-8")
    with serving(tmp_path, "job.toml") as server, browsing(chromium, server, 400) as (page, heard):
        page.goto(f"{server.base}/measurement")
        page.get_by_role("button", name="Select the FRFs in hit.txt").click()
        page.wait_for_url("**/table")
        choose(page, "frequency", "Frequency")
        choose(page, "real part", "b 1")  # mistaken for the imaginary part
        choose(page, "imaginary part", "b 1")
        page.get_by_text("are the same").first.wait_for()
        choose(page, "real part", "a 1")
        response = page.get_by_label("response *")
        response.focus()
        page.wait_for_timeout(400)  # as long as a list may take the focus back when it is closed
        expect(response).to_be_focused()
        response.fill("2:X")
        page.get_by_label("reference *").fill("2:X")
        choose(page, "measured quantity", "accelerance")
        page.get_by_text("1 response, 1 reference, 60 lines").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        page.get_by_role("button", name="Use these columns").click()
        page.wait_for_url("**/measurement")
        page.get_by_text("60 of 60 lines are used").wait_for()
        assert job.read_text(encoding="utf-8") == text
        page.get_by_role("button", name="Save").click()
        page.get_by_text("job.toml", exact=True).wait_for()
        assert heard.wrong == []
    test = tomllib.loads(job.read_text(encoding="utf-8"))["test"]
    assert (test["file"], test["quantity"]) == ("hit.txt", "accelerance")
    assert test["columns"]["channels"] == [
        {"response": "2:X", "reference": "2:X", "real": "a 1", "imaginary": "b 1"}
    ]
