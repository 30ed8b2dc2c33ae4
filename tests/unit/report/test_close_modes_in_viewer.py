"""Close modes in the viewer: their arbitrary bases are brought to the same shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.report.scene import scene_of
from updyn.report.section import PageContent

N = 3
LABELS = [f"{i + 1}:{way}" for way in "XY" for i in range(N)]
GEOMETRY = updyn.Geometry(
    [1, 2, 3], [[0.0, 0.0, z] for z in (1.0, 2.0, 3.0)], lines=[(1, 2), (2, 3)]
)


def mast(split):
    """Three storeys in X and Y, stiffer in Y by a share."""
    K = 2e4 * (np.diag([2.0, 2.0, 1.0]) - np.eye(N, k=1) - np.eye(N, k=-1))
    group = updyn.Group(scipy.linalg.block_diag(K, (1 + split) * K), np.eye(2 * N))
    return updyn.Model.from_groups({"mast": group}, LABELS, geometry=GEOMETRY)


def layers(model, modes):
    """Displacements of the layers, and the labels of the rows; the update changes nothing."""
    own = updyn.modes(model, 2 * N)
    fitted = updyn.ModeSet(own.frequency, own.shapes, LABELS)
    result = updyn.update(model, fitted, updyn.parameters(model, stiffness="mast"))
    result = replace(result, modes=updyn.modal_table(result, modes))
    models = {"updated": model, "start": model}
    scene = scene_of(PageContent(result), models, [modes], [], "mast", moves=True)
    labels = [row.label for row in scene.modes.rows]
    return {layer.name: layer.shapes for layer in scene.modes.layers}, labels


@pytest.mark.parametrize("split", [0.0, 2e-4, 0.1])
def test_shapes_of_a_row_are_alike_in_any_basis(split):
    """Whether the modes are close in the model, too, or in the test only."""
    bending = updyn.modes(mast(1e-6), 2 * N)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    shapes = bending.shapes @ np.kron(np.eye(N), turn)
    modes = updyn.ModeSet(bending.frequency, shapes, LABELS)
    shown, rows = layers(mast(split), modes)
    assert len(rows) == 2 * N
    assert shown["test"] == pytest.approx(shown["updated"], abs=1e-6)
    assert shown["start"] == pytest.approx(shown["updated"], abs=1e-6)
    pairs = shown["updated"].reshape(N, 2, -1)
    for one, two in pairs:  # the two modes of a pair are different shapes
        assert abs(np.vdot(one, two)) < 1e-6 * np.linalg.norm(one) * np.linalg.norm(two)
    assert "subspace MAC 1.000, close modes combined" in rows[0]


def test_separate_modes_are_as_they_were_computed():
    model = mast(0.1)
    computed = updyn.modes(model, 2 * N)
    modes = updyn.ModeSet(computed.frequency, computed.shapes, LABELS)
    shown, rows = layers(model, modes)
    for shape, expected in zip(shown["updated"], computed.shapes.T, strict=True):
        assert np.sort(shape.ravel())[[0, -1]] == pytest.approx(
            [min(0, expected.min()), max(0, expected.max())]
        )
    assert "combined" not in rows[0]
