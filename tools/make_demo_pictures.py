"""Draw the small pictures of the demos for the page Start of the window.

A structure in three dimensions is drawn by its lines, any other by the first FRF of its last test:
as measured, or of the model if few lines are measured and it is linear.

    python tools/make_demo_pictures.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from updyn.demos import DEMOS
from updyn.dynamics.response import response
from updyn.job import Prepared, load_job, prepare
from updyn.report.picture import VIEWS, camera
from updyn.report.plots import thin_indices

FOLDER = Path(__file__).parents[1] / "src" / "updyn" / "web" / "pictures"
WIDTH, HEIGHT, MARGIN = 240.0, 110.0, 6.0  # px
#: Most points of a curve: about two for each pixel.
POINTS = 400
#: A structure is drawn if its smallest extent is at least this part of the largest.
SOLID = 0.1


def fit_box(points: np.ndarray, *, keep_shape: bool) -> np.ndarray:
    """Return points, shape (n, 2), scaled into the picture, y downwards."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([WIDTH, HEIGHT]) - 2 * MARGIN
    scale = room / np.where(high > low, high - low, 1.0)
    if keep_shape:
        scale[:] = scale.min()
    middle = (points - 0.5 * (low + high)) * scale
    return middle * [1.0, -1.0] + [0.5 * WIDTH, 0.5 * HEIGHT]


def draw_structure(ready: Prepared) -> str:
    """Return the lines of a structure as an SVG path."""
    geometry = ready.model.geometry
    assert geometry is not None
    xy = fit_box(geometry.xyz @ camera(*VIEWS["front"])[:2].T, keep_shape=True)
    return "".join(
        f"M{a[0]:.0f} {a[1]:.0f}L{b[0]:.0f} {b[1]:.0f}"
        for a, b in dict.fromkeys(
            (tuple(xy[i].round()), tuple(xy[j].round())) for i, j in geometry.line_ends
        )
        if a != b
    )


def draw_frf(ready: Prepared) -> str:
    """Return the magnitude of the first FRF as an SVG path."""
    last = ready.tests[-1].frf
    frf = last.select(responses=last.responses[:1], references=last.references[:1])
    if len(frf.freq) < POINTS and not ready.model.nonlinear:
        grid = np.linspace(frf.freq[0], frf.freq[-1], POINTS)
        frf = response(ready.model, grid, frf.responses, frf.references, frf.quantity)
    level = np.log(np.abs(frf.values[:, 0, 0]))
    at = thin_indices(level, POINTS)
    xy = fit_box(np.column_stack([frf.freq[at], level[at]]), keep_shape=False)
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in xy)


def draw(ready: Prepared) -> str:
    """Return the picture of a demo as SVG."""
    geometry = ready.model.geometry
    extents = np.zeros(3) if geometry is None else np.ptp(geometry.xyz, axis=0)
    is_solid = extents.min() >= SOLID * extents.max() > 0.0
    path, width = (draw_structure(ready), 0.5) if is_solid else (draw_frf(ready), 1.2)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}"'
        f' fill="none" stroke="currentColor" stroke-width="{width}" stroke-linejoin="round"'
        f' aria-hidden="true"><path d="{path}"/></svg>\n'
    )


def main() -> None:
    """Write the pictures of all demos."""
    FOLDER.mkdir(exist_ok=True)
    for demo in DEMOS.values():
        with tempfile.TemporaryDirectory() as folder:
            text = draw(prepare(load_job(demo.write_inputs(Path(folder)))))
        (FOLDER / f"{demo.name}.svg").write_text(text, encoding="utf-8")
        sys.stdout.write(f"{demo.name}: {len(text)} characters\n")


if __name__ == "__main__":
    main()
