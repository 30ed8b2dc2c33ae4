"""How quick the window of `updyn serve` is with much in it: the first picture, and a click.

    python benchmarks/app.py                # 100 channels of 2,000 lines; a solid of 50,653 nodes
    python benchmarks/app.py --nodes 11     # edge of the solid in nodes

Drawn by software in headless Chromium, on a server on the same machine: both share its processors.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

import updyn
from updyn.elements.structure.build import structure
from updyn.elements.structure.solids import Solid

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from programs import program
from window import browsing, serving

CHANNELS, LINES = 100, 2000
#: Takes the time in ms, since the request for the page, at which its first picture is shown.
FIRST_SHOWN = """new MutationObserver((_, observer) => {
  if (!document.querySelector(".js-plotly-plot .main-svg")) return;
  observer.disconnect();
  requestAnimationFrame(() => setTimeout(() => { window.firstShown = performance.now(); }));
}).observe(document, { childList: true, subtree: true });"""
#: Aims: first picture in s, a click in ms.
FIRST, CLICK = 4.0, 200.0


def cube(n: int) -> updyn.Model:
    """Return a cube of n x n x n nodes, its bottom held."""
    axis = np.linspace(0.0, 1.0, n)
    xyz = np.array([[x, y, z] for z in axis for y in axis for x in axis])
    i, j, k = np.meshgrid(*[np.arange(n - 1)] * 3, indexing="ij")
    first = (1 + i + n * (j + n * k)).ravel()
    corners = [0, 1, n + 1, n, n * n, n * n + 1, n * n + n + 1, n * n + n]
    elements = np.stack([first + c for c in corners], axis=1)
    lower = xyz[elements[:, 0] - 1, 2] < 0.5
    parts = [
        Solid("lower", elements[lower], 7e10, 2700.0),
        Solid("upper", elements[~lower], 7e10, 2700.0),
    ]
    return structure(xyz, parts, grounded=range(1, n * n + 1), title="Cube")


def measured(n: int, seed: int) -> updyn.FRF:
    """Return FRFs with resonances and noise at nodes of the top; not those of the cube."""
    rng = np.random.default_rng(seed)
    freq = np.linspace(1.0, 2000.0, LINES)
    poles = rng.uniform(50.0, 1900.0, 25)
    shapes = rng.standard_normal((25, CHANNELS))
    values = np.einsum(
        "fm,mc->fc", 1e-6 / (poles**2 - freq[:, None] ** 2 + 0.02j * poles**2), shapes
    )
    values *= 1.0 + 0.01 * rng.standard_normal(values.shape)
    top = n**3 - np.arange(CHANNELS)
    return updyn.FRF(
        freq, values[:, :, None], [f"{node}:Z" for node in top], [f"{top[0]}:Z"], "accelerance"
    )


def project(folder: Path, n: int) -> None:
    """Write model, measurement and job."""
    updyn.write_model(cube(n), folder / "cube.h5")
    updyn.write_frf(measured(n, 0), folder / "cube.npz")
    (folder / "job.toml").write_text(
        'model.file = "cube.h5"\ntest.file = "cube.npz"\n'
        '[[parameter]]\ngroups = "all"\nquantity = "stiffness"\nbounds = [0.5, 2.0]\n',
        encoding="utf-8",
    )


def seconds(do) -> float:
    start = time.perf_counter()
    do()
    return time.perf_counter() - start


def report(what: str, value: float, aim: float, unit: str) -> None:
    print(
        f"{what:58s} {value:8.3g} {unit:2s}  {'met' if value <= aim else 'missed'} ({aim:g} {unit})"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--nodes", type=int, default=37)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp())
    try:
        project(folder, options.nodes)
        with sync_playwright() as playwright:
            chromium = playwright.chromium.launch(
                executable_path=program("browser"), args=["--no-sandbox"]
            )
            measure(folder, chromium)
            chromium.close()
    finally:
        shutil.rmtree(folder)


def measure(folder: Path, chromium: object) -> None:
    with serving(folder, "job.toml") as server, browsing(chromium, server) as (page, heard):
        page.add_init_script(FIRST_SHOWN)

        def go(place: str) -> float:
            page.goto(f"{server.base}{place}")
            return 1e-3 * page.wait_for_function("window.firstShown").json_value()

        size = (folder / "cube.h5").stat().st_size / 2**20
        print(f"{CHANNELS} channels of {LINES} lines, a model of {size:.0f} MB")
        print(f"{'model read and matched once':58s} {go('/measurement'):8.3g} s")
        report("Measurement, first picture", go("/measurement"), FIRST, "s")
        page.wait_for_timeout(2000)

        def redraw(click: Callable[[], None]) -> float:
            page.wait_for_selector(".js-plotly-plot .main-svg")
            page.evaluate(
                "() => { window.drawn = new Promise((done) =>"
                " document.querySelector('.js-plotly-plot').once('plotly_afterplot', done)); }"
            )
            start = time.perf_counter()
            click()
            page.evaluate("() => window.drawn")
            return 1e3 * (time.perf_counter() - start)

        def choose(what: str, name: str) -> float:
            page.get_by_label(what, exact=True).click()
            option = page.get_by_role("option", name=name, exact=True)
            option.wait_for()
            return redraw(option.click)

        button = lambda name: page.get_by_role("button", name=name, exact=True)  # noqa: E731
        print(f"{'Measurement, another page of channels':58s} {redraw(button('2').click):8.3g} ms")
        button("One channel").click()
        page.get_by_text("phase", exact=True).wait_for()
        names = updyn.read_frf(folder / "cube.npz").responses.labels
        times = [choose("response", name) for name in names[1:8]]
        report("Measurement, another channel (median of 7)", statistics.median(times), CLICK, "ms")
        start = time.perf_counter()
        button("Map").click()
        page.wait_for_selector(".heatmaplayer image")
        shown = 1e3 * (time.perf_counter() - start)
        print(f"{'Measurement, map of all channels':58s} {shown:8.3g} ms")
        report(
            "Structure, the viewer is there",
            seconds(
                lambda: (
                    page.goto(f"{server.base}/model"),
                    page.frame_locator("iframe").locator("canvas").wait_for(),
                )
            ),
            FIRST,
            "s",
        )
        assert heard.wrong == [], heard.wrong


if __name__ == "__main__":
    main()
