"""Structures for the viewer: a block of solids, a plate, a shaft that only turns."""

from __future__ import annotations

import numpy as np

import updyn
from updyn.elements.structure.build import structure
from updyn.elements.structure.solids import Solid
from updyn.geometry import Geometry
from updyn.model import Group, Model
from updyn.viewer import model_scene

#: Waits for the next frame and then some ms. Messages keep the page from resting until the frame: the
#: virtual time of a page at rest runs out.
LATER = """const later = async (ms) => {
  const { port1, port2 } = new MessageChannel();
  let drawn = false;
  requestAnimationFrame(() => { drawn = true; });
  await new Promise((done) => {
    port1.onmessage = () => { if (drawn) done(); else port2.postMessage(0); };
    port2.postMessage(0);
  });
  await new Promise((done) => setTimeout(done, ms));
};"""
#: For scripts in a page with the viewer's `stage`: the pixels of a copy of its canvas, right after a frame.
PIXELS = """const pixels = () => {
  stage.draw();
  const copy = Object.assign(document.createElement("canvas"), { width: stage.canvas.width, height: stage.canvas.height });
  const context = copy.getContext("2d");
  context.drawImage(stage.canvas, 0, 0);
  return context.getImageData(0, 0, copy.width, copy.height).data;
};"""


def block(counts=(4, 2, 2), size=(0.4, 0.1, 0.1)):
    """Hexahedra in a row of two groups, held at X = 0; the halves meet in the middle."""
    nx, ny, nz = counts
    axes = [np.linspace(0.0, s, n + 1) for s, n in zip(size, counts, strict=True)]
    xyz = np.array([[x, y, z] for z in axes[2] for y in axes[1] for x in axes[0]])

    def at(i, j, k):
        return 1 + i + (nx + 1) * (j + (ny + 1) * k)

    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    cells = [(i, j, k) for k in range(nz) for j in range(ny) for i in range(nx)]
    elements = np.array([[at(i + a, j + b, k + c) for a, b, c in corners] for i, j, k in cells])
    left = np.array([i < nx // 2 for i, _, _ in cells])
    parts = [
        Solid("left", elements[left], 7e10, 2700.0),
        Solid("right", elements[~left], 7e10, 2700.0),
    ]
    held = [n for n in range(1, len(xyz) + 1) if xyz[n - 1, 0] == 0.0]
    return structure(xyz, parts, grounded=held, title="Block <b>")


def shaft():
    """Three inertias that only turn about Z."""
    k = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    geometry = Geometry([5, 6, 7], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], [[5, 6], [6, 7]])
    return Model.from_groups(
        {"shaft": Group(stiffness=1e4 * k, mass=np.eye(3))},
        ["5:RZ", "6:RZ", "7:RZ"],
        geometry=geometry,
    )


def block_scene(**more):
    model = block()
    return model_scene(
        model, updyn.modes(model, 3), responses=["15:Z", "45:-Y"], references=["15:Z"], **more
    )
