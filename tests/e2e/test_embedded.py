"""What is clicked in the pages that the window embeds becomes an edit of the job; names stay text."""

from __future__ import annotations

import re
import tomllib

import pytest

from page_waits import wait_for
from updyn.demos import find_demo
from window import browsing, serving

pytest.importorskip("nicegui")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

BAND = [100.0, 700.0]  # Hz
FIND = "label => document.querySelector('[data-scene]').updynViewer.find(label)"
#: Where a frequency is in the figure of the page of modes.
PLACE = """frequency => {
  const place = document.getElementById("picker-plot"), { xaxis, yaxis } = place._fullLayout;
  place.scrollIntoView();
  return { x: xaxis._offset + xaxis.d2p(frequency), y: yaxis._offset + yaxis._length / 2 };
}"""


@pytest.fixture(scope="module")
def window(chromium, tmp_path_factory):
    folder = tmp_path_factory.mktemp("project")
    job = find_demo("beam").write_inputs(folder)
    text = job.read_text(encoding="utf-8")
    text = text.replace('title = "Steel beam, whole"', "title = '<b id=\"bold\">Beam</b>'", 1)
    text = text.replace("[method]", "[modes]\ndamping = 'structural'\n\n[method]", 1)
    assert "bold" in text
    # a small part of the measured band has modes enough
    text = re.sub(r"^band = .*$", f"band = {BAND}", text, flags=re.MULTILINE)
    lines = [f for f in re.findall(r"[\d.]+", text.split("lines = [")[1]) if float(f) < BAND[1]]
    text = f"{text.split('lines = [')[0]}lines = [{', '.join(lines)}]\n"
    job.write_text(text, encoding="utf-8")
    with serving(folder, "job.toml") as server, browsing(chromium, server) as (page, heard):
        yield server, page, heard, job
        assert heard.wrong == []


def embedded(page, ready):
    """The page within the page, once it has drawn."""
    handle = page.wait_for_selector("iframe")
    frame = handle.content_frame()
    wait_for(frame, ready)
    return frame


def saved(page, job):
    """The job after it was saved."""
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_text("job.toml", exact=True).wait_for()
    return tomllib.loads(job.read_text(encoding="utf-8"))


def test_a_sensor_is_moved_by_two_clicks(window):
    server, page, _, job = window
    page.goto(f"{server.base}/model")
    drawn = "() => document.querySelector('[data-scene]')?.updynViewer?.find"
    frame = embedded(page, drawn)
    frame.evaluate(FIND, 107)  # the picture: the sensor that is there
    page.get_by_text("107:Z: click its node").wait_for()
    frame.evaluate(FIND, 102)
    page.get_by_text("job.toml (edited)").wait_for()
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("job.toml", exact=True).wait_for()
    page.get_by_role("button", name="Redo").click()
    assert saved(page, job)["match"]["table"]["107:Z"] == "102:Z"
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("job.toml (edited)").wait_for()
    assert "107:Z" not in saved(page, job).get("match", {}).get("table", {})


def test_the_groups_at_a_node_are_offered(window):
    server, page, _, _ = window
    page.goto(f"{server.base}/unknowns")
    frame = embedded(page, "() => document.querySelector('[data-scene]')?.updynViewer?.find")
    page.get_by_role("checkbox", name="pads stiffness").wait_for()
    frame.evaluate(FIND, 102)
    page.get_by_role("button", name="Show all groups").click()
    page.get_by_role("checkbox", name="pads stiffness").wait_for()


def test_modes_are_added_and_left_out(window):
    server, page, _, job = window
    page.goto(f"{server.base}/modes")
    page.get_by_role("button", name="Save and begin").click()
    page.get_by_role("status").filter(has_text="Ended").wait_for()
    drawn = "() => document.querySelector('#picker-plot .main-svg')"
    frame = embedded(page, drawn)
    frame.locator("#add-frequency").fill("120")
    frame.get_by_role("button", name="Add", exact=True).click()
    page.get_by_text("Modes for the job: all that are found, and new ones at 120 Hz.").wait_for()
    assert saved(page, job)["modes"]["poles"] == [120.0]
    frame = embedded(page, drawn)
    modes = frame.evaluate("updynPicks.entries.filter((entry) => entry.found).map((e) => e.f)")
    frame.locator("#picker-plot").click(position=frame.evaluate(PLACE, modes[0]))
    page.get_by_text("Modes for the job: those at").wait_for()
    picked = saved(page, job)["modes"]
    assert picked["pick"] == pytest.approx(modes[1:], rel=1e-6)
    assert picked["poles"] == [120.0]

    # what is undone, and what is opened anew, is what the job says
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("Modes for the job: all that are found").wait_for()
    count = f"{len(modes) + 1} modes, 1 of them not refined yet."
    page.frame_locator("iframe").get_by_text(count).wait_for()
    page.reload()
    page.frame_locator("iframe").get_by_text(count).wait_for()

    # refused with its reason; the page stays, and the pick is taken back in it
    page.frame_locator("iframe").get_by_role("button", name="120 Hz").wait_for()
    page.get_by_role("button", name="Save and begin").click()
    page.get_by_role("status").filter(has_text="Failed").wait_for()
    page.get_by_text("the pole at 120 Hz, refined,").wait_for()
    page.frame_locator("iframe").get_by_role("button", name="120 Hz").click()
    page.get_by_text("Modes for the job: all that are found.").wait_for()
    assert "poles" not in saved(page, job)["modes"]


def test_pages_within_pages_are_light_or_dark_as_the_window_is(window):
    server, page, _, _ = window
    page.goto(f"{server.base}/model")
    ground = "() => getComputedStyle(document.body).backgroundColor"
    drawn = "() => document.querySelector('[data-scene]')?.updynViewer?.find"
    for chosen, colour in (("dark", "rgb(20, 23, 27)"), ("light", "rgb(255, 255, 255)")):
        page.get_by_role("button", name="Light or dark").click()
        with page.expect_navigation():
            page.get_by_text(chosen, exact=True).click()
        assert embedded(page, drawn).evaluate(ground) == colour
        assert page.evaluate(ground) == colour
        page.goto(f"{server.base}/job")
        page.wait_for_selector(".cm-editor")
        editor = page.evaluate("() => getComputedStyle(document.querySelector('.cm-editor')).color")
        assert editor == page.evaluate("() => getComputedStyle(document.body).color")
        page.goto(f"{server.base}/model")


def test_html_in_a_title_is_text(window):
    server, page, _, _ = window
    for place in ("/", "/job", "/measurement", "/run", "/results"):
        page.goto(f"{server.base}{place}")
        page.get_by_text("job.toml").first.wait_for()
        assert page.locator("#bold").count() == 0
        for frame in page.frames:
            assert frame.locator("#bold").count() == 0


def test_a_message_that_is_no_pick_is_left_alone(window):
    server, page, _, _ = window
    page.goto(f"{server.base}/unknowns")
    page.get_by_role("checkbox", name="pads stiffness").wait_for()
    frame = embedded(page, "() => document.querySelector('[data-scene]')?.updynViewer?.find")
    for message in (
        "'text'",
        "{ updynPick: 3 }",
        "{ updynPick: { pick: [-1], poles: [] } }",
        "{ updynPick: { groups: {}, label: [] } }",
    ):
        frame.evaluate(f"parent.postMessage({message}, '*')")
    page.evaluate("window.postMessage({ updynPick: { groups: ['pads'] } }, '*')")  # not of a frame
    page.wait_for_timeout(1000)
    assert page.get_by_role("button", name="Show all groups").count() == 0


def test_two_tabs_show_the_same_job(window):
    server, page, heard, _ = window
    other = page.context.new_page()
    heard.listen(other)
    other.goto(f"{server.base}/unknowns")
    page.goto(f"{server.base}/unknowns")
    box = page.get_by_role("checkbox", name="pads loss_factor")
    box.wait_for()
    box.click()
    other.get_by_text("job.toml (edited)").wait_for()
    other.get_by_role("checkbox", name="pads loss_factor", checked=False).wait_for()
    other.get_by_role("button", name="Undo").click()
    page.get_by_role("checkbox", name="pads loss_factor", checked=True).wait_for()
    other.close()
