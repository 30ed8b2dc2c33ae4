"""What goes wrong while the window is open: faulty data, a closed tab, a killed run, a text that is no job."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tomllib
from contextlib import contextmanager
from dataclasses import replace

import pytest

import updyn
from updyn.demos import find_demo
from window import browsing, serving

pytest.importorskip("nicegui")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def window(chromium, tmp_path_factory):
    """The chain with a sensor that was mounted upside down; its run goes on for some seconds."""
    folder = tmp_path_factory.mktemp("project")
    job = find_demo("chain").write_inputs(folder)
    with job.open("a", encoding="utf-8") as text:
        text.write('\n[uncertainty]\nkind = "bootstrap"\nn = 40\n')
    frf = updyn.read_frf(folder / "chain.uff")
    row = frf.responses.labels.index("5:X")
    values = frf.values.copy()
    values[:, row] *= -1.0
    (folder / "chain.uff").unlink()
    updyn.write_frf(replace(frf, values=values), folder / "chain.uff")
    with serving(folder, "job.toml") as server, browsing(chromium, server) as (page, heard):
        yield server, page, heard, job
        assert heard.wrong == []


def workers(server):
    """The processes of tasks that this server has begun."""
    found = subprocess.run(
        ["ps", "-o", "pid=,args=", "--ppid", str(server.pid)],
        capture_output=True,
        text=True,
        check=False,
    )
    return [int(row.split()[0]) for row in found.stdout.splitlines() if "updyn.web.work" in row]


@contextmanager
def no_file_beyond(server, size):
    """As on a full disk: neither the server nor what it begins meanwhile writes more bytes into a file."""
    resource = pytest.importorskip("resource")
    pid = server.pid
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def state(page, pattern):
    place = page.get_by_role("status").filter(has_text=re.compile(pattern))
    place.wait_for()
    return place.inner_text()


def undo_all(page):
    """What is typed with pauses is undone in pieces."""
    saved = page.get_by_text("job.toml", exact=True)
    for _ in range(24):
        if saved.count():
            break
        page.get_by_role("button", name="Undo").click()
        page.wait_for_timeout(700)
    saved.wait_for()


def test_a_fault_is_repaired_by_a_button(window):
    server, page, _, job = window
    page.goto(f"{server.base}/measurement")
    page.get_by_role("button", name="Look for faults of the data").click()
    page.get_by_role("button", name="Repair: sign:5:X").click()
    page.get_by_text("job.toml (edited)").wait_for()
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_text("job.toml", exact=True).wait_for()
    assert tomllib.loads(job.read_text(encoding="utf-8"))["test"]["repair"] == ["sign:5:X"]


@pytest.mark.skipif(os.name == "nt", reason="ps is not there")
def test_a_killed_run_says_so_and_a_closed_tab_does_not_end_one(window):
    server, page, heard, _ = window
    page.goto(f"{server.base}/run")
    page.get_by_role("button", name="Save and run").click()
    state(page, "^Running: ")
    (pid,) = workers(server)
    os.kill(pid, signal.SIGKILL)
    state(page, "^Failed")
    page.get_by_text("The process was ended by SIGKILL").wait_for()

    page.get_by_role("button", name="Resume").click()
    state(page, "^Running")
    page.goto("about:blank")  # as a closed tab
    other = page.context.new_page()
    heard.listen(other)
    other.goto(f"{server.base}/run")
    assert state(other, "^Ended") == "Ended: converged"
    other.close()


def test_a_text_that_is_no_job_stays_and_says_where(window):
    server, page, _, job = window
    page.goto(f"{server.base}/job")
    before = job.read_text(encoding="utf-8")
    editor = page.locator(".cm-content")
    editor.click()
    page.keyboard.press("Control+Home")
    page.keyboard.type("bnad = 3\n")
    page.get_by_text(re.compile("job.toml:1: .*bnad")).first.wait_for()
    page.goto(f"{server.base}/measurement")
    page.get_by_text(re.compile("job.toml:1: .*bnad")).first.wait_for()
    undo_all(page)
    assert job.read_text(encoding="utf-8") == before


def test_save_stays_the_same_button_while_the_job_is_typed(window):
    server, page, _, _ = window
    page.goto(f"{server.base}/job")
    save = page.get_by_role("button", name="Save", exact=True).element_handle()
    page.locator(".cm-content").click()
    page.keyboard.press("Control+Home")
    page.keyboard.type("# once\n")
    page.get_by_text("job.toml (edited)").wait_for()
    assert save.is_enabled()
    undo_all(page)
    assert save.is_disabled()
    assert save.evaluate("button => button.isConnected"), "a click on it would be lost"


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of another process is set by Linux")
def test_a_full_disk_is_said_and_costs_nothing(window):
    server, page, _, job = window
    before = job.read_text(encoding="utf-8")
    (manifest,) = job.parent.rglob("manifest.json")
    results = manifest.parent
    kept = {path.name: path.read_bytes() for path in results.iterdir() if path.is_file()}
    page.goto(f"{server.base}/job")
    page.locator(".cm-content").click()
    page.keyboard.press("Control+Home")
    page.keyboard.type("# measured on Monday\n")
    page.get_by_text("job.toml (edited)").wait_for()
    with no_file_beyond(server, 64):
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_text(re.compile("job.toml: cannot be written")).first.wait_for()
        assert job.read_text(encoding="utf-8") == before
        assert page.get_by_text("job.toml (edited)").count()
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_text("job.toml", exact=True).wait_for()
    assert job.read_text(encoding="utf-8") == f"# measured on Monday\n{before}"

    page.goto(f"{server.base}/run")
    with no_file_beyond(server, 20_000):
        page.get_by_role("button", name="Save and run").click()
        state(page, "^Running")
        assert state(page, "^Failed")
        page.get_by_text(re.compile("cannot be written")).first.wait_for()
    assert {p.name: p.read_bytes() for p in results.iterdir() if p.name in kept} == kept
