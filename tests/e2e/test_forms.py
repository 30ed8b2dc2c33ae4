"""Forms of the window: typed at the speed of a machine, incomplete, invalid, and after a restart."""

from __future__ import annotations

import tomllib

import pytest

from updyn.demos import find_demo
from window import PATIENCE, browsing, choose, serving, visit

pytest.importorskip("nicegui")
expect = pytest.importorskip("playwright.sync_api").expect
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
PLAN = {"sensors *": "3", "forces": "2", "band, from and to (Hz) *": "0.6, 22"}


PAUSES = (0, 150, 450, 700)  # ms


@pytest.fixture
def job(tmp_path):
    return find_demo("chain").write_inputs(tmp_path)


@pytest.fixture(scope="module")
def window(chromium, tmp_path_factory):
    """A project with a job for each test, in one window."""
    folder = tmp_path_factory.mktemp("project")
    job = find_demo("chain").write_inputs(folder)
    for name in ("boxes", "tabs", "halted", *(f"pause{between}" for between in PAUSES)):
        (folder / f"{name}.toml").write_bytes(job.read_bytes())
    with serving(folder) as server, browsing(chromium, server) as (page, heard):
        yield server, page, folder
        assert heard.wrong == []


def open_job(window, name):
    """Open a job of the project; return its path."""
    server, page, folder = window
    visit(page, server.base)
    page.get_by_role("button", name=f"{name}.toml").click()
    page.wait_for_url("**/measurement")
    return folder / f"{name}.toml"


def table(job, name):
    """A table of the job as it is saved."""
    return tomllib.loads(job.read_text(encoding="utf-8")).get(name)


def save(page, job):
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_text(job.name, exact=True).wait_for()


@pytest.mark.parametrize("between", PAUSES)
def test_all_that_is_typed_quickly_is_saved(window, between):
    """The page looks for changes every half second, with pauses within it and beyond."""
    server, page, _ = window
    job = open_job(window, f"pause{between}")
    visit(page, f"{server.base}/plan")
    page.get_by_label("sensors *", exact=True).wait_for()
    for label, text in PLAN.items():
        page.get_by_label(label, exact=True).click()
        page.keyboard.press("Control+a")  # over what the data propose
        page.keyboard.type(text)
        page.wait_for_timeout(between)
    save(page, job)
    assert table(job, "plan") == {"n_sensors": 3, "n_references": 2, "band": [0.6, 22.0]}
    for label, text in PLAN.items():  # as the job says
        shown = page.get_by_label(label, exact=True).input_value()
        assert shown.replace("22.0", "22") == text


def test_a_value_of_another_tab_does_not_replace_what_is_being_typed(window):
    server, page, _ = window
    job = open_job(window, "tabs")
    visit(page, f"{server.base}/plan")
    page.get_by_label("sensors *", exact=True).fill("3")
    band = page.get_by_label("band, from and to (Hz) *", exact=True)
    band.click()
    page.keyboard.press("Control+a")
    other = page.context.new_page()
    visit(other, f"{server.base}/plan")
    other.get_by_label("band, from and to (Hz) *", exact=True).fill("1, 5")
    other.keyboard.press("Enter")
    other.get_by_text(f"{job.name} (edited)").wait_for()
    other.get_by_label("forces", exact=True).fill("2")
    other.keyboard.press("Enter")
    expect(page.get_by_label("forces", exact=True)).to_have_value("2", timeout=PATIENCE)
    page.keyboard.type("0.6, 22")
    other.close()
    save(page, job)
    assert table(job, "plan") == {"n_sensors": 3, "n_references": 2, "band": [0.6, 22.0]}


def test_boxes_clicked_quickly_are_all_taken(window):
    names = [f"part{n} {kind}" for n in (1, 2, 3, 4) for kind in ("mass", "loss_factor")]
    server, page, _ = window
    job = open_job(window, "boxes")
    visit(page, f"{server.base}/unknowns")
    page.get_by_role("checkbox", name=names[0]).wait_for()
    for name in names:
        page.get_by_role("checkbox", name=name).click()
    for name in names:
        page.get_by_role("checkbox", name=name, checked=False).wait_for()
    save(page, job)
    assert {item["quantity"] for item in table(job, "parameter")} == {"stiffness"}


def test_nothing_is_lost_while_the_server_does_not_answer(window):
    """The connection of a page lasts longer than a pause of a busy computer."""
    server, page, _ = window
    job = open_job(window, "halted")
    visit(page, f"{server.base}/unknowns")
    first, second = (page.get_by_role("checkbox", name=f"part{n} mass") for n in (1, 2))
    first.click()
    page.get_by_text(f"{job.name} (edited)").wait_for()
    with server.halted():
        second.click()
        page.get_by_role("button", name="Save", exact=True).click()
        page.wait_for_timeout(9000)  # ms; 6 s lost both clicks once
    page.get_by_text(job.name, exact=True).wait_for()
    masses = [item["groups"] for item in table(job, "parameter") if item["quantity"] == "mass"]
    assert masses == [["part3", "part4"]]


def test_nothing_incomplete_or_invalid_is_written_or_begun(chromium, job):
    before = job.read_bytes()
    with serving(job.parent, "job.toml") as server, browsing(chromium, server) as (page, heard):
        visit(page, f"{server.base}/plan")
        begin = page.get_by_role("button", name="Save and begin")
        expect(page.get_by_label("band, from and to (Hz)")).to_have_value(
            "0.634882, 22.6954", timeout=PATIENCE
        )
        assert begin.is_enabled()
        page.get_by_label("band, from and to (Hz)").fill("")
        page.get_by_label("sensors *", exact=True).fill("3")
        page.keyboard.press("Enter")
        page.get_by_role("alert").filter(has_text="missing key 'band' in [plan]").wait_for()
        assert begin.is_disabled()
        page.get_by_text("required", exact=True).first.wait_for()
        visit(page, f"{server.base}/measurement")  # kept while another page is shown
        visit(page, f"{server.base}/plan")
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
        visit(page, f"{server.base}/plan")
        page.frame_locator("iframe").get_by_role("heading").first.wait_for()
        page.get_by_text("job-plan/plan.html").wait_for()
        assert heard.wrong == []


def test_a_job_without_the_suffix_is_listed(chromium, job):
    with serving(job.parent) as server, browsing(chromium, server) as (page, heard):
        choose(page, "model", "chain.uff")
        page.get_by_text("is a measurement; expected a model").wait_for()
        choose(page, "model", "chain.h5")
        choose(page, "measurement", "chain.uff")
        page.get_by_label("Name of the job").fill("job")
        page.get_by_text("job.toml: exists already").wait_for()
        page.get_by_label("Name of the job").fill("portal")
        page.get_by_role("button", name="Create the job").click()
        page.wait_for_url("**/measurement")
        visit(page, server.base)
        page.get_by_role("button", name="portal.toml").wait_for()
        assert heard.wrong == []
