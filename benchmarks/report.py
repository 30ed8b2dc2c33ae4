"""Size of report pages, and how soon a browser shows them.

A report of many channels and lines, and the viewer of a large geometry, are opened in headless
Chromium with software rendering: time to the first paint, time until what is in the window is
there, processor time of the page's main thread until then, time of a frame of the viewer, and time
from a key to what it changes: of each the least of the runs. Wall times are those of the machine
as it is; where other work runs beside, the processor time says more.

    python benchmarks/report.py [--channels 100] [--lines 2000] [--nodes 50000] [--repeat 3]
    python benchmarks/report.py --page FILE.html
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import updyn
from updyn import viewer
from updyn.elements.structure.build import structure
from updyn.elements.structure.solids import Solid
from updyn.model import Model

#: What a page tells of itself: paints, when what is in the window is drawn, frames of the viewer,
#: and a key in the picture of all channels.
PROBE = """<script>(() => {
  const seen = {};
  const note = (list) => {
    for (const entry of list.getEntries()) seen[entry.name] = entry.startTime;
  };
  new PerformanceObserver(note).observe({ type: "paint", buffered: true });
  const inside = (place) => {
    const box = place.getBoundingClientRect();
    return box.height && place.checkVisibility() && box.top < innerHeight && box.bottom > 0;
  };
  const there = (place) => (
    place.dataset.scene ? place.dataset.ready : place.querySelector(".main-svg, canvas")
  );
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const unfold = (place, section) => {
    if (typeof updynReport !== "undefined") updynReport.reveal(section);
    place.scrollIntoView({ behavior: "instant" });
  };
  const finished = (gl) => {
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
  const look = async () => {
    const all = document.querySelectorAll("[data-scene], [data-figure], #all-channels-plot");
    const places = [...all].filter(inside);
    if (document.readyState !== "complete" || !places.every(there)) {
      requestAnimationFrame(look);
      return;
    }
    await frame();
    seen.ready = performance.now();
    console.log("MEASURED " + JSON.stringify(seen));
    const scene = document.querySelector("[data-scene]");
    if (scene) {
      unfold(scene, "viewer");
      while (!scene.updynViewer) await wait(5);
      const viewer = scene.updynViewer;
      viewer.clock.play(false);
      const gl = viewer.stage.canvas.getContext("webgl2");
      const drawn = (angle) => {
        viewer.phase(angle);
        viewer.stage.draw();
        finished(gl);
      };
      drawn(0);
      const began = performance.now();
      for (let i = 1; i <= 5; i++) drawn(i);
      seen.frame = (performance.now() - began) / 5;
      const picked = performance.now();
      viewer.find(viewer.bodies[0].labels[0]);
      seen.pick = performance.now() - picked;
      if (viewer.modes) {
        const chosen = performance.now();
        viewer.set({ row: viewer.modes.rows.length - 1 });
        viewer.stage.draw();
        finished(gl);
        seen.mode = performance.now() - chosen;
      }
    }
    const plot = document.getElementById("all-channels-plot");
    if (plot) {
      unfold(plot, "all-channels");
      const began = performance.now();
      while (!plot.updynChannels) await wait(5);
      await frame();
      seen.channels = performance.now() - began;
      const pressed = performance.now();
      plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
      seen.key = performance.now() - pressed;
    }
    console.log("MEASURED " + JSON.stringify({ ...seen, done: true }));
  };
  requestAnimationFrame(look);
})();</script>"""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE = "1280,900"


def browser() -> str:
    """The browser."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return found
    raise SystemExit(f"none of {', '.join(BROWSERS)} is installed")


def opened(page: Path) -> dict[str, float]:
    """What a page measures of itself in ms, and ``cpu``, the processor time until it is ready."""
    with tempfile.TemporaryDirectory() as folder:
        probed = Path(folder) / "page.html"
        text = page.read_text(encoding="utf-8")
        probed.write_text(text.replace("<head>", "<head>" + PROBE, 1), encoding="utf-8")
        command = [
            browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
            f"--user-data-dir={folder}/profile", "--disable-background-networking",
            "--disable-dev-shm-usage", f"--window-size={SIZE}", "--enable-logging=stderr",
            "--enable-unsafe-swiftshader", "--remote-debugging-port=0", probed.as_uri(),
        ]  # fmt: skip
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            found: dict[str, float] = {}
            try:
                assert process.stderr is not None
                for line in process.stderr:
                    told = re.search(r"MEASURED (\{.*?\})\"", line)
                    if told is None:
                        continue
                    found |= json.loads(told[1].replace('\\"', '"'))
                    found.setdefault("cpu", processor_time(process.pid))
                    if found.pop("done", False):
                        return found
            finally:
                process.terminate()
    raise SystemExit(f"{page}: the browser went away before the page was ready")


def processor_time(parent: int) -> float:
    """Processor time in ms of the main thread of the busiest page below a process (Linux)."""
    tick = 1000.0 / os.sysconf("SC_CLK_TCK")
    found = 0.0
    for pid in below(parent):
        try:
            command = Path(f"/proc/{pid}/cmdline").read_text()
            own = Path(f"/proc/{pid}/task/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if "--type=renderer" in command:
            found = max(found, tick * (int(own[11]) + int(own[12])))
    return found


def below(parent: int) -> Iterator[int]:
    """The processes below a process."""
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == parent:
            yield int(entry.name)
            yield from below(int(entry.name))


# -- pages -----------------------------------------------------------------------------------------
def many_channels(channels: int, lines: int, path: Path) -> None:
    """A report of a fit with so many channels and lines: solids, 1 % noise, coherence."""
    n = max(channels // 2, 1)
    model = block((max(n // 8, 2), 2, 2))
    model = model.scaled({name: {"loss_factor": 0.02} for name in model.groups})
    true = model.scaled({"right": {"stiffness": 0.8}})
    nodes = model.dofs.nodes.tolist()[::3]
    responses = [f"{node}:{axis}" for axis in "ZYX" for node in nodes][:n]
    frequencies = updyn.modes(true, 12).frequency
    freq = np.linspace(0.3 * frequencies[0], 1.02 * frequencies[-1], lines)
    clean = updyn.response(true, freq, responses, responses[:2], "accelerance")
    rng = np.random.default_rng(0)
    real, imaginary = rng.standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + 0.01 / np.sqrt(2.0) * (real + 1j * imaginary))
    coherence = np.full(values.shape, 1.0 / (1.0 + 2.0e-4 * 10))
    frf = updyn.FRF(
        freq, values, clean.responses, clean.references, "accelerance",
        coherence=coherence, averages=10,
    )  # fmt: skip
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    result = updyn.update(model, frf, unknowns, lines="d-optimal:40", starts=0)
    print(f"report of {len(responses) * 2} channels, {lines} lines: {result.status}")
    updyn.write_report(result, path)


def block(counts: tuple[int, int, int]) -> Model:
    """Hexahedra in two groups, held at one end."""
    nx, ny, nz = counts
    axes = [np.arange(n + 1) * 0.05 for n in counts]
    xyz = np.array([[x, y, z] for z in axes[2] for y in axes[1] for x in axes[0]])
    steps = np.array([1, nx + 1, (nx + 1) * (ny + 1)])
    corner = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    corners = np.concatenate([corner, corner + np.array([0, 0, 1])]) @ steps
    cells = np.array([[i, j, k] for k in range(nz) for j in range(ny) for i in range(nx)])
    elements = 1 + (cells @ steps)[:, None] + corners
    left = cells[:, 0] < nx // 2
    parts = [
        Solid("left", elements[left], 7e10, 2700.0),
        Solid("right", elements[~left], 7e10, 2700.0),
    ]
    held = (1 + np.flatnonzero(xyz[:, 0] == 0.0)).tolist()
    return structure(xyz, parts, grounded=held, title="Block")


def many_nodes(nodes: int, path: Path) -> None:
    """The viewer of a shell with so many nodes in four groups, with ten shapes that move."""
    n = int(np.sqrt(nodes))
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0, 4, n))
    xyz = np.column_stack([np.cos(u).ravel(), np.sin(u).ravel(), v.ravel()])
    at = np.arange(n * n).reshape(n, n)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], -1).reshape(-1, 4)
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    lines = np.concatenate([quads[:, [0, 1]], quads[:, [0, 3]]])
    group = (4 * v.ravel() / 4.001).astype(np.intp)
    none = np.empty(0, dtype=np.intp)
    body = viewer.Body(
        "model", 1 + np.arange(n * n), xyz, lines, group[lines[:, 0]], halves, group[halves[:, 0]],
        none, none, ("a", "b", "c", "d"), n * n,
    )  # fmt: skip
    outward = xyz * [1, 1, 0]
    waves = [np.cos(k * u.ravel()) * np.sin(np.pi * v.ravel() / 4) for k in range(2, 12)]
    shapes = np.array([outward * wave[:, None] for wave in waves])
    layer = viewer.Layer("model", "after", "surface", 0, shapes)
    rows = [viewer.ModeRow(f"{k + 1}: wave", (k,)) for k in range(10)]
    colours = viewer.by_size("size", "-", [1, 2, 3, 4], body.groups)
    modes = viewer.ModeShapes([layer], rows)
    scene = viewer.Scene([body], "Shell", [colours], [], modes)
    path.write_text(viewer.page(scene), encoding="utf-8")
    print(f"viewer of {n * n} nodes, {len(halves)} triangles, {len(lines)} lines")


NAMES = {
    "first-contentful-paint": "first paint",
    "ready": "window drawn",
    "cpu": "processor time until then",
    "frame": "frame of the viewer",
    "pick": "node picked",
    "mode": "next mode shown",
    "channels": "all channels drawn",
    "key": "channel by a key",
}


def table(page: Path, repeat: int) -> None:
    """Print the size of a page, and the least of each time: other work only adds to it."""
    runs = [opened(page) for _ in range(repeat)]
    print(f"| size | {page.stat().st_size / 1e6:.2f} MB |\n|---|---|")
    for key, name in NAMES.items():
        values = [run[key] for run in runs if key in run]
        if values:
            print(f"| {name} | {min(values):.0f} ms |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--channels", type=int, default=100)
    parser.add_argument("--lines", type=int, default=2000)
    parser.add_argument("--nodes", type=int, default=50_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--page", type=Path, default=None)
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps the pages")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.page is not None:
        table(given.page, given.repeat)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        if given.nodes:
            many_nodes(given.nodes, folder / "viewer.html")
            table(folder / "viewer.html", given.repeat)
        if given.channels:
            many_channels(given.channels, given.lines, folder / "report.html")
            table(folder / "report.html", given.repeat)


if __name__ == "__main__":
    main()
