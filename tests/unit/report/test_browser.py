"""The page in a real browser: figures are drawn, the channel picker works, nothing is refused and nothing fails."""

from __future__ import annotations

import re

import pytest

import updyn
from pages_read import attributes, dump, unfolded
from report_case import hostile, realistic

pytestmark = pytest.mark.needs("browser")

# What a user does: next channel by button, back by key twice, logarithmic axis, a figure saved as
# SVG, a cell of FRAC.
ACTIONS = """<script>
(async () => {
  const root = document.documentElement, at = () => document.getElementById("channel-name").textContent;
  const until = async (true_) => { while (!true_()) await new Promise((done) => setTimeout(done, 20)); };
  const places = [...document.querySelectorAll("[data-figure], #overlay-plot")].filter((place) => !place.closest("details:not(.fold)"));
  const first = [...document.querySelectorAll("#evidence [data-figure]")];
  await until(() => first.length && first.every((place) => place.querySelector(".main-svg")));
  await new Promise((done) => setTimeout(done, 500)); // nothing else is drawn
  root.dataset.lazy = places.some((place) => place.closest("details.fold") && place.querySelector(".main-svg"));
  const said = [at()];
  document.getElementById("next-channel").click(); said.push(at());
  const key = (name) => document.getElementById("overlay").dispatchEvent(new KeyboardEvent("keydown", { key: name }));
  key("ArrowLeft"); key("ArrowLeft"); said.push(at());
  root.dataset.channels = said.join("|");
  document.querySelector("input[name=freq-scale][value=log]").click();
  const plot = document.getElementById("overlay-plot");
  location.hash = "#frfs"; // drawn when it is unfolded, as the keys and the buttons left it
  await until(() => plot.querySelector(".main-svg"));
  document.querySelector("#frfs details").open = false;
  root.dataset.axis = plot._fullLayout.xaxis.type;
  root.dataset.title = plot._fullLayout.yaxis.title.text;
  root.dataset.first = plot.calcdata[0][0].y.toPrecision(5);
  const svg = await Plotly.toImage(plot, { format: "svg", imageDataOnly: true });
  root.dataset.svg = svg.startsWith("<svg");
  const folds = [...document.querySelectorAll("details.fold")], open = () => folds.filter((part) => part.open).length;
  const counts = [open()]; // all folded; a link opens its section, the button all, and folds them again
  document.querySelector('a[href="#identifiability"]').click(); counts.push(open());
  const button = document.getElementById("unfold");
  button.click(); counts.push(folds.length - open());
  root.dataset.beyond = root.scrollWidth - innerWidth; // nothing is wider than the window: tables scroll in their box
  const boxes = [...document.querySelectorAll("table")].map((table) => table.closest(".scroll"));
  await until(() => places.every((place) => place.querySelector(".main-svg"))); // one after the other
  root.dataset.boxes = boxes.every((box) => box && getComputedStyle(box).overflowX === "auto");
  button.click(); counts.push(open());
  root.dataset.folds = counts.join(" ");
  document.querySelector("[data-figure=frf-correlation-after]").emit("plotly_click", { points: [{ x: 0, y: 3 }] });
  root.dataset.shown = document.querySelector("#frfs details").open; // a cell opens the section that it leads to
  root.dataset.cell = `${at()}; ${document.getElementById("channel-figures").textContent}`;
})();
</script></body>"""

# What is printed: the colours of a figure and of the page on screen, on paper and afterwards.
PRINTING = """<script>
(async () => {
  const root = document.documentElement, place = document.querySelector("[data-figure=overview-changes]");
  while (!place.querySelector(".xtick text")) await new Promise((done) => setTimeout(done, 20)); // drawn after this script
  const shade = (element, name) => getComputedStyle(element)[name];
  const seen = () => [shade(place.querySelector(".xtick text"), "fill"), shade(document.body, "color")].join(" ");
  const said = [seen()];
  for (const name of ["beforeprint", "afterprint"]) { dispatchEvent(new Event(name)); said.push(seen()); }
  root.dataset.dark = matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.seen = said.join("|");
})();
</script></body>"""


def test_page_is_drawn_and_works(tmp_path):
    result = realistic()
    path = updyn.write_report(result, tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    path.write_text(ACTIONS.join(text.rsplit("</body>", 1)), encoding="utf-8")
    dom = dump(path, tmp_path / "profile")
    found = attributes(dom)
    assert "errors" not in found, found["errors"]
    assert found["lazy"] == "false"
    # 17 figures and the overlay, of two layers each at least
    assert len(re.findall(r'class="main-svg"', dom)) >= 36
    names = [re.sub(r"\(channel.*", "", c).strip() for c in found["channels"].split("|")]
    assert names == [
        "Response at 1:Z, force at 3:Z",
        "Response at 4:Z, force at 3:Z",
        "Response at 12:Z, force at 12:Z",
    ]
    assert found["axis"] == "log"
    assert found["title"].endswith("((m/s²)/N)")
    # the browser draws what was measured: the first line of the channel that the keys led to
    assert float(found["first"]) == pytest.approx(abs(result.frf.values[0, 4, 1]), rel=1e-4)
    assert found["svg"] == "true"
    assert found["folds"] == "0 1 0 0"
    assert found["shown"] == "true"
    assert int(found["beyond"]) <= 0
    assert found["boxes"] == "true"
    assert "Response at 9:Z, force at 3:Z" in found["cell"]
    assert "held out" in found["cell"]


def test_a_dark_screen_prints_on_white_paper(tmp_path):
    path = updyn.write_report(realistic(), tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    path.write_text(PRINTING.join(text.rsplit("</body>", 1)), encoding="utf-8")
    found = attributes(dump(path, tmp_path / "profile", "--blink-settings=preferredColorScheme=0"))
    assert "errors" not in found, found["errors"]
    assert found["dark"] == "true"
    light, dark = "rgb(27, 31, 36)", "rgb(230, 233, 237)"
    screen, paper, after = found["seen"].split("|")
    assert screen == after == f"{dark} {dark}"
    assert paper == f"{light} {light}"


def test_hostile_text_runs_nothing(tmp_path):
    path = updyn.write_report(hostile(), tmp_path / "report.html")
    dom = dump(unfolded(path), tmp_path / "profile")
    assert "errors" not in attributes(dom)
    assert int(attributes(dom)["drawn"]) > 10
    assert not re.search(r"<b [^>]*onmouseover", dom)
    assert "<img" not in dom


def test_the_page_of_several_tests_is_drawn(tmp_path):
    one = realistic()
    both = updyn.JointResult({"rotor locked": one, "rotor <free>": one}, "Two tests")
    path = updyn.write_report(both, tmp_path / "report.html")
    dom = dump(unfolded(path), tmp_path / "profile")
    assert "errors" not in attributes(dom)
    assert int(attributes(dom)["drawn"]) > 4
    assert 'href="rotor%20%3Cfree%3E/report.html"' in dom
