"""All channels in one picture, in a real browser: the curves are the data, pointer and keys find a channel and open it."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from page_waits import wait_for
from pages_read import settled_and_overheard, told
from programs import program
from report_case import realistic

pytestmark = pytest.mark.needs("browser")

#: What a user does: points at a curve, clicks, goes on by keys, opens a channel by Enter, switches a set of curves off.
ACTIONS = """<script>
(async () => {
  const root = document.documentElement, place = document.getElementById("all-channels-plot");
  const note = (name, value) => { root.dataset[name] = typeof value === "string" ? value : JSON.stringify(value); };
  const until = async (there) => { while (!there()) await new Promise((done) => setTimeout(done, 20)); };
  updynReport.reveal("all-channels");
  place.scrollIntoView({ behavior: "instant" });
  await until(() => place.updynChannels);
  const drawn = place.updynChannels, said = () => document.getElementById("all-channels-said").textContent;
  note("curves", drawn.plot.series.length - 1);
  note("level", drawn.sets[0].levels.map((own) => own[3]));
  note("axes", [...drawn.plot.axes].map((axis) => axis.label));
  // a point that lies on one curve alone
  const u = drawn.plot, { lines, levels } = drawn.sets[0];
  const at = (k, i) => [u.valToPos(lines[i], "x"), u.valToPos(levels[k][i], "y")];
  let best = [0, 0, 0];
  for (let i = 5; i < lines.length - 5; i += Math.ceil(lines.length / 20)) {
    const places = drawn.drawn.map((set) => {
      const near = set.lines.findIndex((f) => f >= lines[i]);
      return set.levels.map((own) => u.valToPos(own[near], "y"));
    });
    for (let k = 0; k < levels.length; k++) {
      const y = at(k, i)[1];
      if (y < 2 || y > u.over.clientHeight - 2) continue;
      const away = Math.min(...places.flatMap((own) => own.filter((_, j) => j !== k).map((other) => Math.abs(other - y))));
      if (away > best[2]) best = [k, i, away];
    }
  }
  note("apart", best);
  const [x, y] = at(best[0], best[1]), box = u.over.getBoundingClientRect();
  const mouse = (type, target) => target.dispatchEvent(new MouseEvent(type, { clientX: box.left + x, clientY: box.top + y, bubbles: true }));
  mouse("mousemove", u.over);
  await until(() => drawn.at >= 0);
  note("pointed", [best[0], drawn.at]);
  note("said", said());
  const ink = drawn.canvas.getContext("2d").getImageData(0, 0, drawn.canvas.width, drawn.canvas.height).data;
  note("traced", ink.filter((value, i) => i % 4 === 3 && value > 0).length);
  mouse("mousedown", u.over); mouse("mouseup", document); mouse("click", u.over);
  const name = () => document.getElementById("channel-name").textContent.replace(/ \\(.*/, "");
  note("opened", [document.querySelector("#frfs details").open, name()]);
  const key = (what) => place.dispatchEvent(new KeyboardEvent("keydown", { key: what, bubbles: true }));
  drawn.pick(-1);
  key("ArrowRight"); key("ArrowRight"); key("Enter");
  note("keyed", [drawn.at, name(), place.tabIndex]);
  document.querySelector("input[name=all-sets][value=after]").click();
  note("fewer", drawn.plot.series.length - 1);
  document.querySelector("input[name=all-scale][value=log]").click();
  note("log", drawn.plot.scales.x.distr);
  note("requests", performance.getEntriesByType("resource").map((entry) => entry.name));
  note("done", true);
})();
</script></body>"""


@pytest.fixture(scope="module")
def result():
    return realistic()


@pytest.fixture(scope="module")
def opened(result, tmp_path_factory):
    """What the page noted, what it wrote to the console, and the addresses that it asked for."""
    folder = tmp_path_factory.mktemp("channels")
    path = updyn.write_report(result, folder / "report.html")
    text = path.read_text(encoding="utf-8")
    path.write_text(ACTIONS.join(text.rsplit("</body>", 1)), encoding="utf-8")
    return settled_and_overheard(path, folder / "profile", "done")


def test_a_channel_is_found_among_all_and_opened(result, opened):
    found, _, _ = opened
    assert "errors" not in found, found["errors"]
    frf = result.frf
    names = [
        f"Response {r}, force {c}" for r in frf.responses.labels for c in frf.references.labels
    ]
    n = len(names)
    assert told(found, "curves") == 2 * n  # measured and updated
    kept = frf.values[frf.freq > 0]
    np.testing.assert_allclose(told(found, "level"), np.abs(kept[3]).ravel(), rtol=1e-6)
    assert told(found, "axes") == ["frequency (Hz)", "accelerance magnitude ((m/s²)/N)"]
    meant, pointed = told(found, "pointed")
    assert pointed == meant
    assert found["said"].startswith(f"{names[meant]}: relative residual ")
    assert int(found["traced"]) > 300
    unfolded, name = told(found, "opened")
    assert unfolded is True
    assert (
        name.replace("Response at", "Response").replace("force at", "force").strip() == names[meant]
    )
    assert told(found, "keyed")[0] == 1
    assert told(found, "keyed")[2] == 0  # reachable by Tab
    assert told(found, "fewer") == n
    assert told(found, "log") == 3
    assert told(found, "requests") == []


def test_it_asks_nothing_of_anyone(opened):
    _, console, asked = opened
    assert console == []
    assert {address for address in asked if not address.startswith(("file:", "data:"))} == set()


def test_on_paper_the_picture_is_as_wide_as_the_sheet(result, tmp_path):
    """What hangs over its edge has the browser print the whole report smaller."""
    sync_api = pytest.importorskip("playwright.sync_api")
    path = updyn.write_report(result, tmp_path / "report.html")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program("browser"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(300_000)
        page.goto(path.as_uri())
        page.evaluate(
            "() => { updynReport.reveal('all-channels');"
            " document.getElementById('all-channels-plot').scrollIntoView({ behavior: 'instant' }); }"
        )
        wait_for(page, "() => document.getElementById('all-channels-plot').updynChannels")
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 700, "height": 900})  # the plot hears of it a frame later
        over, drawn, room = page.evaluate(
            """() => {
              const place = document.getElementById("all-channels-plot");
              return [document.documentElement.scrollWidth,
                place.querySelector("canvas").getBoundingClientRect().width, place.clientWidth];
            }"""
        )
        browser.close()
    assert over <= 700
    assert drawn == pytest.approx(room, abs=1)
