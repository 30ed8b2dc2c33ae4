"""The viewer within the page of an update, in a real browser: it draws, moves, picks, and the page asks nothing of anyone."""

from __future__ import annotations

from dataclasses import replace
from html import unescape

import numpy as np
import pytest

import updyn
from pages_read import overheard, settled_and_overheard, told
from viewer_case import LATER, PIXELS, block

pytestmark = pytest.mark.needs("browser")

SENSORS = ["5:Z", "20:-Y", "10:Z"]

# What a user does: unfolds the structure, which moves by itself; picks a node at rest; a mode; a line
# of the operating shapes. Pixels are counted on a copy of the canvas, right after a frame.
ACTIONS = """<script>
(async () => {
  const root = document.documentElement, place = document.querySelector("#viewer [data-scene]");
  const note = (name, value) => { root.dataset[name] = typeof value === "string" ? value : JSON.stringify(value); };
  LATER
  note("waits", !place.updynViewer); // folded
  updynReport.reveal("viewer");
  place.scrollIntoView({ behavior: "instant" });
  while (!place.updynViewer) await later(50);
  const viewer = place.updynViewer, { stage, panel } = viewer;
  const began = viewer.clock.phase;
  while (viewer.clock.phase === began) await later(50);
  note("animated", viewer.clock.phase !== began);
  viewer.clock.play(false);
  note("hidden", [...viewer.state.hidden]);
  note("styles", Object.fromEntries(viewer.layers().map(({ name, style, colour }) => [name, [style, colour]])));
  PIXELS
  const share = (a, b) => { let n = 0; for (let i = 0; i < a.length; i += 4) if (a[i] !== b[i] || a[i + 1] !== b[i + 1] || a[i + 2] !== b[i + 2]) n++; return (4 * n) / a.length; };
  const ground = (data) => data.map((value, i) => data[i % 4]);
  const options = (select) => [...select.options].map((option) => option.textContent);
  note("shows", options(panel.show));
  note("modes", options(panel.row));
  for (const show of ["modes", "operating"]) {
    viewer.set({ show });
    viewer.phase(0);
    const one = pixels();
    viewer.phase(Math.PI);
    note(`${show}drawn`, share(one, ground(one)));
    note(`${show}moved`, share(one, pixels()));
  }
  // Shares of the left and right half in which the test and the model are drawn.
  const halves = (hidden) => {
    viewer.set({ hidden: new Set(hidden) });
    viewer.phase(Math.PI / 3);
    const data = pixels(), blank = data.slice(0, 3), wide = stage.canvas.width, free = ((stage.size[0] - stage.covered) / stage.size[0]) * wide;
    const found = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
      const x = (i / 4) % wide;
      if (x < free && (data[i] !== blank[0] || data[i + 1] !== blank[1] || data[i + 2] !== blank[2])) found[x < free / 2 ? 0 : 1]++;
    }
    return found.map((one) => (4 * one) / data.length);
  };
  const checked = () => [...panel.layers.querySelectorAll("input")].map((box) => box.checked);
  viewer.set({ show: "modes", hidden: new Set() });
  const all = checked();
  viewer.set({ hidden: new Set(["test"]) });
  note("checked", [all, checked()]);
  viewer.set({ show: "modes", labels: false, beside: true, hidden: new Set(["start"]) });
  const ghosts = (visible) => { viewer.ghost.visible = visible; if (viewer.testGhost) viewer.testGhost.visible = visible; };
  note("testlines", viewer.bodies[1].lines.length / 2);
  note("beside", viewer.isSplit);
  note("sides", [...panel.svg.querySelectorAll(".v-side")].map((one) => one.textContent));
  for (const [name, hidden] of [["onlytest", ["updated", "start"]], ["onlymodel", ["test", "start"]]]) {
    const draw = stage.draw.bind(stage);
    stage.draw = () => { ghosts(false); draw(); };
    note(name, halves(hidden));
    stage.draw = draw;
  }
  viewer.set({ hidden: new Set(["start"]), labels: true, beside: false });
  note("whole", viewer.isSplit);
  viewer.set({ show: "rest" });
  const heard = [];
  document.addEventListener("updyn-pick", (event) => heard.push(event.detail));
  const node = viewer.bodies[0].labels.indexOf(20), [x, y] = stage.project(viewer.base.placeOf(node));
  const box = stage.canvas.getBoundingClientRect();
  for (const type of ["pointerdown", "pointerup"]) {
    stage.canvas.dispatchEvent(new PointerEvent(type, { clientX: box.left + x, clientY: box.top + y, bubbles: true, pointerId: 1 }));
  }
  note("picked", heard);
  note("said", panel.said.textContent);
  note("requests", performance.getEntriesByType("resource").map((entry) => entry.name));
  note("done", true);
})();
</script></body>""".replace("PIXELS", PIXELS).replace("LATER", LATER)


@pytest.fixture(scope="module")
def result():
    start = block((4, 1, 1))
    start = start.scaled({name: {"loss_factor": 0.03} for name in start.groups})
    stiff = start.scaled({"right": {"stiffness": 0.8}})
    freq = np.linspace(200.0, 3000.0, 113)
    frf = updyn.response(stiff, freq, SENSORS, ["5:Z"], "accelerance")
    rng = np.random.default_rng(5)
    noise = rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape)
    frf = replace(frf, values=frf.values * (1.0 + 1e-3 * noise))
    return updyn.update(start, frf, updyn.parameters(start, stiffness="all"))


@pytest.fixture(scope="module")
def opened(result, tmp_path_factory):
    """What the page noted, what it wrote to the console, and the addresses that it asked for."""
    folder = tmp_path_factory.mktemp("viewer")
    path = updyn.write_report(result, folder / "report.html")
    text = path.read_text(encoding="utf-8")
    assert "default-src 'none'" in unescape(text)
    path.write_text(ACTIONS.join(text.rsplit("</body>", 1)), encoding="utf-8")
    return settled_and_overheard(path, folder / "profile", "done")


def test_it_draws_moves_and_picks(result, opened):
    found, _, _ = opened
    assert "errors" not in found, found["errors"]
    assert found["done"] == "true"
    assert found["waits"] == "true"
    assert found["animated"] == "true"
    assert told(found, "shows") == ["at rest", "modes", "operating shapes"]
    (first,) = updyn.modes(result.model, 1).frequency
    assert f"updated {first:.5g} Hz" in told(found, "modes")[0]
    # operating shapes are drawn at the sensors alone
    for show, share in (("modes", 0.05), ("operating", 0.005)):
        assert float(found[f"{show}drawn"]) > share
        assert float(found[f"{show}moved"]) > share / 5
    # the start is a grey dashed ghost, off at first; the test has no colour of the map
    assert told(found, "hidden") == ["start"]
    assert told(found, "styles") == {
        "updated": ["surface", "after"],
        "start": ["ghost", "muted"],
        "test": ["dots", "third"],
    }
    assert told(found, "checked") == [[True, True, True], [True, True, False]]
    # side by side: the test on the left, the model on the right
    assert told(found, "beside") is True
    assert told(found, "sides") == ["test", "updated"]
    assert told(found, "whole") is False
    for name, here in (("onlytest", 0), ("onlymodel", 1)):
        shares = told(found, name)
        assert shares[here] > 0.0005
        assert shares[1 - here] == 0.0
    assert told(found, "testlines") >= 2  # no loose dots: three sensors, connected
    (picked,) = told(found, "picked")
    assert picked["label"] == 20
    geometry = result.start.geometry
    np.testing.assert_allclose(picked["position"], geometry.position([20])[0], rtol=1e-6)
    assert picked["groups"] == ["right"]
    assert picked["sensors"] == ["20:-Y"]
    assert found["said"].startswith("Node 20 · (0.4, 0.1, 0.1) m · right: stiffness −20 %")
    assert told(found, "requests") == []


def test_it_asks_nothing_of_anyone(opened):
    _, console, asked = opened
    assert console == []
    assert {address for address in asked if not address.startswith(("file:", "data:"))} == set()


def test_what_a_page_asks_for_is_heard(tmp_path):
    path = tmp_path / "loud.html"
    path.write_text('<img src="http://127.0.0.1:9/away.png"><script>console.error("loud")</script>')
    console, asked = overheard(path, tmp_path / "profile")
    assert any("loud" in line for line in console)
    assert "http://127.0.0.1:9/away.png" in asked
