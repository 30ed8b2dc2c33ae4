"""The viewer in a real browser, drawn by software: it draws, moves, picks, saves, and asks nothing of anyone."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from pages_read import settled, told
from updyn.report.templates import asset
from updyn.viewer import Body, Colouring, Scene, model_scene, page
from updyn.viewer.colourings import scale_of_changes
from viewer_case import LATER, PIXELS, block, block_scene

pytestmark = pytest.mark.needs("browser")

# What a user does. Pixels are counted on a copy of the canvas, right after a frame.
ACTIONS = """<script>
(async () => {
  const root = document.documentElement, place = document.querySelector("[data-scene]");
  const note = (name, value) => { root.dataset[name] = typeof value === "string" ? value : JSON.stringify(value); };
  LATER
  while (!place.updynViewer) await later(50);
  const viewer = place.updynViewer, { stage, panel } = viewer;
  note("playing", viewer.clock.playing);
  viewer.clock.play(false);
  PIXELS
  const differing = (a, b) => { let n = 0; for (let i = 0; i < a.length; i += 4) if (a[i] !== b[i] || a[i + 1] !== b[i + 1] || a[i + 2] !== b[i + 2]) n++; return n; };
  viewer.phase(Math.PI / 2);
  const still = pixels(), ground = new Uint8ClampedArray(still.length);
  for (let i = 0; i < ground.length; i++) ground[i] = still[i % 4];
  note("drawn", differing(still, ground) / (still.length / 4));
  viewer.phase(0);
  note("moved", differing(still, pixels()) / (still.length / 4));
  viewer.set({ show: "rest" });
  const heard = [];
  document.addEventListener("updyn-pick", (event) => heard.push(event.detail));
  const node = viewer.bodies[0].labels.indexOf(45), [x, y] = stage.project(viewer.base.placeOf(node));
  const box = stage.canvas.getBoundingClientRect();
  for (const type of ["pointerdown", "pointerup"]) {
    stage.canvas.dispatchEvent(new PointerEvent(type, { clientX: box.left + x + 3, clientY: box.top + y, bubbles: true, pointerId: 1 }));
  }
  note("picked", heard);
  note("said", panel.said.textContent);
  const key = (name, more) => stage.canvas.dispatchEvent(new KeyboardEvent("keydown", { key: name, ...more }));
  const eye = () => stage.camera.position.toArray().map((value) => value.toFixed(4)).join();
  const before = eye();
  key("ArrowRight"); note("turned", eye() !== before);
  key("+"); note("zoomed", stage.camera.zoom);
  key("f"); note("fitted", stage.camera.zoom);
  key("n"); note("next", heard.at(-1).label);
  note("options", [...panel.row.options].map((option) => option.textContent));
  note("legend", panel.legend.innerText);
  const across = viewer.bodies[0].labels.map((_, i) => stage.project(viewer.base.placeOf(i))[0]);
  note("beside", Math.max(...across) < panel.legend.offsetLeft && Math.min(...across) > 0);
  viewer.set({ show: "modes", row: 1, colouring: "displacement" });
  note("relative", panel.legend.innerText);
  const bytes = async (blob) => [...new Uint8Array(await blob.arrayBuffer()).slice(0, 6)];
  note("png", await bytes(await viewer.screenshot()));
  note("gif", await bytes(await viewer.animation()));
  note("requests", performance.getEntriesByType("resource").map((entry) => entry.name));
  note("done", true);
})();
</script></body>""".replace("PIXELS", PIXELS)


def opened(scene, tmp_path, *switches, actions=ACTIONS, last="done"):
    """Return what the page of a scene noted, `last` at its end."""
    text = page(scene).replace("</head>", f"<script>{asset('watch.js')}</script></head>")
    path = tmp_path / "viewer.html"
    actions = actions.replace("LATER", LATER)
    path.write_text(actions.join(text.rsplit("</body>", 1)), encoding="utf-8")
    return settled(path, tmp_path / "profile", last, *switches)


def test_it_draws_moves_and_picks(tmp_path):
    change = Colouring(
        "Change of stiffness",
        "%",
        [("less-4", "−20"), ("more-4", "+12")],
        [0, 1],
        ["left: −20 %", "right: +12 %"],
    )
    scene = block_scene(colourings=[change])
    found = opened(scene, tmp_path)
    assert "errors" not in found, found["errors"]
    assert found["done"] == "true"
    assert found["playing"] == "true"
    assert float(found["drawn"]) > 0.05
    assert float(found["moved"]) > 0.01
    (picked,) = told(found, "picked")
    assert picked["label"] == 45
    at = scene.bodies[0].nodes.tolist().index(45)
    np.testing.assert_allclose(picked["position"], scene.bodies[0].xyz[at], rtol=1e-6)
    assert picked["groups"] == ["right"]
    assert picked["sensors"] == ["45:-Y"]
    assert found["said"] == "Node 45 · (0.4, 0.1, 0.1) m · right: +12 % · sensors 45:-Y"
    assert found["turned"] == "true"
    assert float(found["zoomed"]) > 1.0
    assert float(found["fitted"]) == 1.0
    assert found["next"] == "15"
    assert len(told(found, "options")) == 3
    assert found["legend"].startswith("Change of stiffness (%)")
    assert told(found, "beside") is True  # all nodes left of the legend, which covers none
    assert "Displacement (relative)" in found["relative"]
    assert told(found, "png") == [137, 80, 78, 71, 13, 10]
    assert bytes(told(found, "gif")) == b"GIF89a"
    assert told(found, "requests") == []


CORNER = """<script>
(async () => {
  const place = document.querySelector("[data-scene]");
  LATER
  while (!place.updynViewer) await later(50);
  const { stage } = place.updynViewer;
  PIXELS
  document.documentElement.dataset.corner = JSON.stringify([...pixels().slice(0, 3)]);
})();
</script></body>""".replace("PIXELS", PIXELS)


@pytest.mark.parametrize(("look", "ground"), [("dark", [20, 23, 27]), ("light", [255, 255, 255])])
def test_the_ground_of_the_picture_is_that_of_the_page(tmp_path, look, ground):
    text = page(block_scene()).replace("<html ", f'<html data-look="{look}" ')
    path = tmp_path / "viewer.html"
    path.write_text(
        CORNER.replace("LATER", LATER).join(text.rsplit("</body>", 1)), encoding="utf-8"
    )
    assert told(settled(path, tmp_path / "profile", "corner"), "corner") == ground


FILLED = """<script>
(async () => {
  const place = document.querySelector("[data-scene]"), root = document.documentElement;
  LATER
  while (!place.updynViewer) await later(50);
  const bottom = (name) => document.querySelector(name).getBoundingClientRect().bottom;
  root.dataset.below = innerHeight - bottom(".v-low");
  root.dataset.high = bottom(".v-stage canvas") / innerHeight;
  root.dataset.scrolls = root.scrollHeight > innerHeight;
  root.dataset.done = true;
})();
</script></body>"""


def test_it_fills_its_page(tmp_path):
    found = opened(block_scene(), tmp_path, "--window-size=700,640", actions=FILLED)
    assert "errors" not in found, found["errors"]
    assert 0.0 < float(found["below"]) < 12.0  # px: the margin of the page
    assert float(found["high"]) > 0.6
    assert found["scrolls"] == "false"


def test_less_motion_starts_at_rest(tmp_path):
    found = opened(block_scene(), tmp_path, "--force-prefers-reduced-motion")
    assert "errors" not in found, found["errors"]
    assert found["playing"] == "false"


def test_without_webgl_a_line_says_so(tmp_path):
    look = """<script>
      (async () => {
        const place = document.querySelector("[data-scene]");
        LATER
        while (!place.innerText.trim()) await later(50);
        document.documentElement.dataset.said = place.innerText;
      })();
      </script></body>"""
    found = opened(block_scene(), tmp_path, "--disable-3d-apis", actions=look, last="said")
    assert "errors" not in found, found["errors"]
    assert "WebGL 2 is missing" in found["said"]


#: What a scene without choices and a large surface are drawn with.
PARTS = """<script>
(async () => {
  const root = document.documentElement, place = document.querySelector("[data-scene]");
  LATER
  while (!place.updynViewer) await later(50);
  const viewer = place.updynViewer, [body] = viewer.bodies;
  root.dataset.bar = viewer.panel.top.hidden;
  root.dataset.lines = body.lines.length / 2;
  root.dataset.vertices = body.geometry("faces").attributes.aNode.count;
  root.dataset.corners = body.geometry("faces").index.count;
  root.dataset.done = true;
})();
</script></body>"""


def plate(n, fold):
    """A plate of n x n nodes in two groups side by side, folded by a right angle along a line of nodes, and a beam."""
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    along = np.minimum(u, fold)
    xyz = np.stack([along, v, np.maximum(u - fold, 0)], -1).reshape(-1, 3).astype(float)
    xyz = np.concatenate([xyz, [[0.0, 0.0, 9.0]]])
    at = np.arange(n * n).reshape(n, n)
    quads = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], -1).reshape(-1, 4)
    group = (quads[:, 0] % n >= n // 2).astype(np.intp)
    halves = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    edges = np.concatenate([quads[:, [0, 1]], quads[:, [1, 2]], quads[:, [2, 3]], quads[:, [3, 0]]])
    edges = np.concatenate([np.unique(np.sort(edges, axis=1), axis=0), [[0, n * n]]])
    none = np.empty(0, dtype=np.intp)
    return Body(
        "plate", 1 + np.arange(len(xyz)), xyz, edges, np.zeros(len(edges), dtype=np.intp), halves,
        np.concatenate([group, group]), none, none, ("a", "b"), len(xyz),
    )  # fmt: skip


def test_a_large_surface_is_drawn_with_its_outline(tmp_path):
    n = 110
    body = plate(n, 40)
    assert len(body.lines) == 2 * n * (n - 1) + 1
    found = opened(Scene([body]), tmp_path, actions=PARTS)
    assert "errors" not in found, found["errors"]
    # the rim, the fold, where the groups meet, and the beam
    assert int(found["lines"]) == 4 * (n - 1) + (n - 1) + (n - 1) + 1
    assert int(found["corners"]) == 6 * (n - 1) ** 2
    assert int(found["vertices"]) == n * n + n  # once for each node and group
    (tmp_path / "small").mkdir()
    small = opened(Scene([plate(6, 3)]), tmp_path / "small", actions=PARTS)
    assert int(small["lines"]) == 2 * 6 * 5 + 1


def test_a_scene_without_choices_has_no_empty_bar(tmp_path):
    assert opened(Scene([plate(4, 2)]), tmp_path, actions=PARTS)["bar"] == "true"
    (tmp_path / "block").mkdir()
    assert opened(block_scene(), tmp_path / "block", actions=PARTS)["bar"] == "false"


#: The place of labels and structure in the picture, at rest.
LOOKS = """<script>
(async () => {
  const root = document.documentElement, place = document.querySelector("[data-scene]");
  const note = (name, value) => { root.dataset[name] = JSON.stringify(value); };
  LATER
  while (!place.updynViewer) await later(50);
  const viewer = place.updynViewer, { stage, panel, base } = viewer, [body] = viewer.bodies;
  viewer.clock.play(false);
  viewer.set({ show: "rest" });
  const labels = () => {
    stage.draw();
    return [...panel.svg.querySelectorAll(".v-label")].filter((one) => one.getAttribute("visibility") === "visible").map((one) => {
      const { x, y, width, height } = one.getBBox();
      return { text: one.textContent, box: [x, y, x + width, y + height] };
    });
  };
  const seen = Array.from({ length: body.real }, (_, node) => stage.project(base.placeOf(node)));
  const spans = [0, 1].map((c) => Math.max(...seen.map((at) => at[c])) - Math.min(...seen.map((at) => at[c])));
  note("spans", spans);
  note("size", [stage.size[0] - stage.covered, stage.size[1]]);
  note("labels", labels());
  note("ticks", [...panel.legend.querySelectorAll(".v-tick")].map((one) => [one.textContent, parseFloat(one.style.bottom)]));
  const { node } = viewer.given.arrows[0] ?? { node: 0 };
  const [x, y] = stage.project(base.placeOf(node)), box = stage.canvas.getBoundingClientRect();
  stage.canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + x, clientY: box.top + y, pointerId: 1 }));
  note("pointed", labels().map(({ text }) => text));
  stage.canvas.dispatchEvent(new PointerEvent("pointerleave", { pointerId: 1 }));
  note("left", labels().map(({ text }) => text));
  note("done", true);
})();
</script></body>"""


def change_of(groups):
    """A continuous colouring with a label for each group."""
    scale = scale_of_changes(np.linspace(0.8, 1.25, len(groups)), np.log(1.25))
    texts = [f"{group}: changed" for group in groups]
    none = [-1] * len(groups)
    return Colouring("Change", "", [], none, texts, scale=scale, labels=texts)


def overlap(one, other):
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@pytest.mark.parametrize("size", [(4.0, 0.1, 0.1), (0.4, 0.4, 0.05), (0.1, 0.1, 2.0)])
def test_the_structure_fills_the_picture(tmp_path, size):
    scene = model_scene(block((4, 2, 2), size))
    found = opened(scene, tmp_path, actions=LOOKS)
    assert "errors" not in found, found["errors"]
    spans, free = np.array(told(found, "spans")), np.array(told(found, "size"))
    margin = 2 * 20
    assert max(spans / (free - margin)) == pytest.approx(1.0, abs=0.01)
    if size[0] == 4.0:  # a long one lies across the width
        assert spans[0] > 0.85 * free[0]


def test_labels_do_not_overlap(tmp_path):
    model = block()
    labels = [f"{node}:{axis}" for node in (15, 30, 45) for axis in "XYZ"]
    scene = model_scene(
        model, responses=labels, references=["15:Z"], colourings=[change_of(list(model.groups))]
    )
    found = opened(scene, tmp_path, actions=LOOKS)
    assert "errors" not in found, found["errors"]
    seen = told(found, "labels")
    for one, other in combinations(seen, 2):
        assert not overlap(one["box"], other["box"]), (one, other)
    width, height = told(found, "size")
    for one in seen:
        left, top, right, bottom = one["box"]
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
    texts = {one["text"] for one in seen}
    assert {"left: changed", "right: changed"} <= texts
    assert len(texts & set(labels)) >= 5
    assert dict(told(found, "ticks"))["0 %"] == pytest.approx(50.0)


def test_many_labels_come_under_the_pointer(tmp_path):
    model = block((4, 2, 2))
    sensors = [f"{node}:{axis}" for node in (15, 14, 13, 45, 44, 43, 30, 29, 28) for axis in "XYZ"]
    found = opened(model_scene(model, responses=sensors), tmp_path, actions=LOOKS)
    assert "errors" not in found, found["errors"]
    assert told(found, "labels") == []
    pointed = told(found, "pointed")
    assert pointed
    assert set(pointed) <= {"15:X", "15:Y", "15:Z"}
    assert told(found, "left") == []


def test_labels_of_many_parts_name_the_largest_changes_and_the_pointed_one(tmp_path):
    body = plate(9, 8)
    group = np.repeat(np.arange(8), len(body.faces) // 8)
    groups = tuple(f"part {number}" for number in range(8))
    lines = np.full(len(body.lines), -1, dtype=np.intp)
    body = replace(body, groups=groups, face_group=group, line_group=lines)
    found = opened(Scene([body], colourings=[change_of(groups)]), tmp_path, actions=LOOKS)
    assert "errors" not in found, found["errors"]
    # factors from 0.8 to 1.25: those in the middle change least
    assert {one["text"] for one in told(found, "labels")} == {
        f"part {number}: changed" for number in (0, 1, 2, 5, 6, 7)
    }
    at_corner = {int(g) for g, face in zip(group, body.faces, strict=True) if 0 in face}
    assert set(told(found, "pointed")) == {f"part {number}: changed" for number in at_corner}
