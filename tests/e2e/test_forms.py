"""Forms of the window: typed at the speed of a machine, incomplete, invalid, and after a restart."""

from __future__ import annotations

import tomllib

import pytest

from updyn.demos import find_demo
from window import browsing, serving

pytest.importorskip("nicegui")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
PLAN = {"sensors *": "3", "forces": "2", "band, from and to (Hz) *": "0.6, 22"}


@pytest.fixture
def job(tmp_path):
    return find_demo("chain").write_inputs(tmp_path)


def table(job, name):
    """A table of the job as it is saved."""
    return tomllib.loads(job.read_text(encoding="utf-8")).get(name)


def save(page):
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_text("job.toml", exact=True).wait_for()


@pytest.mark.parametrize("between", [0, 150, 450, 700])
def test_all_that_is_typed_quickly_is_saved(chromium, job, between):
    """The page looks for changes every half second, with pauses within it and beyond."""
    with serving(job.parent, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/plan")
        page.get_by_label("sensors *", exact=True).wait_for()
        for label, text in PLAN.items():
            page.get_by_label(label, exact=True).click()
            page.keyboard.type(text)
            page.wait_for_timeout(between)
        save(page)
        assert table(job, "plan") == {"n_sensors": 3, "n_references": 2, "band": [0.6, 22.0]}
        for label, text in PLAN.items():  # as the job says
            shown = page.get_by_label(label, exact=True).input_value()
            assert shown.replace("22.0", "22") == text
        assert heard.wrong == []


def test_boxes_clicked_quickly_are_all_taken(chromium, job):
    names = [f"part{n} {kind}" for n in (1, 2, 3, 4) for kind in ("mass", "loss_factor")]
    with serving(job.parent, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/unknowns")
        page.get_by_role("checkbox", name=names[0]).wait_for()
        for name in names:
            page.get_by_role("checkbox", name=name).click()
        for name in names:
            page.get_by_role("checkbox", name=name, checked=False).wait_for()
        save(page)
        assert heard.wrong == []
    assert {item["quantity"] for item in table(job, "parameter")} == {"stiffness"}


def test_nothing_incomplete_or_invalid_is_written_or_begun(chromium, job):
    before = job.read_bytes()
    with serving(job.parent, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/plan")
        page.get_by_label("sensors *", exact=True).fill("3")
        page.keyboard.press("Enter")
        page.get_by_role("alert").filter(has_text="missing key 'band' in [plan]").wait_for()
        begin = page.get_by_role("button", name="Save and begin")
        assert begin.is_disabled()
        page.get_by_text("required", exact=True).first.wait_for()
        page.goto(f"{server.base}/measurement")  # kept while another page is shown
        page.goto(f"{server.base}/plan")
        page.get_by_label("band, from and to (Hz)").fill("22, 0.6")
        page.get_by_text("band, from and to (Hz): '22, 0.6'; expected two").first.wait_for()
        assert begin.is_disabled()
        assert page.get_by_role("status").count() == 0
        assert job.read_bytes() == before
        page.get_by_label("band, from and to (Hz)").fill("0.6, 22")
        page.get_by_role("button", name="Save and begin").click()
        page.get_by_role("status").filter(has_text="Ended").wait_for()
        assert table(job, "plan") == {"n_sensors": 3, "band": [0.6, 22.0]}
        assert heard.wrong == []

    # a fresh server shows the plan again
    with serving(job.parent, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.goto(f"{server.base}/plan")
        page.frame_locator("iframe").get_by_role("heading").first.wait_for()
        page.get_by_text("job-plan/plan.html").wait_for()
        assert heard.wrong == []


def test_a_job_without_the_suffix_is_listed(chromium, job):
    with serving(job.parent) as server, browsing(chromium, server) as (page, heard):
        page.get_by_role("combobox", name="model").click()
        page.get_by_role("option", name="chain.h5").click()
        page.get_by_role("combobox", name="measurement").click()
        page.get_by_role("option", name="chain.uff").click()
        page.get_by_label("Name of the job").fill("portal")
        page.get_by_role("button", name="Write").click()
        page.wait_for_url("**/job")
        page.goto(server.base)
        page.get_by_role("button", name="portal.toml").wait_for()
        assert heard.wrong == []
