"""Scenes by value: positions, skins, groups, motion, and what the arrays of the JSON decode to."""

from __future__ import annotations

import base64
import dataclasses
import json

import numpy as np
import pytest

import updyn
from updyn.errors import InputError
from updyn.geometry import Geometry
from updyn.viewer import (
    Colouring,
    OperatingLayer,
    OperatingShapes,
    Reference,
    Scene,
    by_size,
    entries_of,
    html,
    model_body,
    model_scene,
    motions,
    page,
    sensor_body,
)
from updyn.viewer.encoding import as_json, encode_scene
from viewer_case import block, block_scene, shaft


def decoded(text, kind):
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def test_the_skin_of_solids_has_their_outer_faces_only():
    model = block((4, 2, 2))
    assert model.geometry.faces.shape == (2 * (4 * 2 + 4 * 2 + 2 * 2), 4)
    body = model_body(model)
    corners = body.xyz[body.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() == pytest.approx(2 * (0.4 * 0.1 + 0.4 * 0.1 + 0.1 * 0.1))
    # no node within, no face between the halves
    low, high = body.xyz.min(axis=0), body.xyz.max(axis=0)
    assert ((np.abs(body.xyz - low) < 1e-12) | (np.abs(body.xyz - high) < 1e-12)).any(axis=1).all()
    middle = np.abs(corners[:, :, 0] - 0.2) < 1e-9
    assert not middle.all(axis=1).any()
    assert len(body.nodes) == 5 * 3 * 3 - 3


def test_faces_belong_to_the_group_of_their_element():
    model = block((4, 2, 2))
    body = model_body(model)
    x = body.xyz[body.faces][:, :, 0].mean(axis=1)
    held = x < 1e-9  # all nodes are held: no telling
    assert set(body.face_group[held].tolist()) == {-1}
    np.testing.assert_array_equal(body.face_group[~held], (x[~held] > 0.2).astype(int))
    assert body.groups == ("left", "right")


def test_shapes_are_the_displacements_of_the_nodes():
    model = block()
    found = updyn.modes(model, 3)
    body = model_body(model)
    moved = motions(body, entries_of(body, model.geometry, found.dofs), found.shapes)
    assert moved.shape == (3, len(body.nodes), 3)
    node = body.nodes.tolist().index(15)
    expected = found.at(["15:X", "15:Y", "15:Z"])
    np.testing.assert_allclose(moved[:, node], expected.T)
    held = np.abs(body.xyz[:, 0]) < 1e-12
    assert not moved[:, held].any()


def test_a_turn_moves_the_rim_of_a_disc_about_its_axis():
    model = shaft()
    body = model_body(model)
    assert body.real == 3
    rim = np.arange(body.real, len(body.nodes))[body.nodes[body.real :] == 6]
    np.testing.assert_allclose(np.linalg.norm(body.xyz[rim] - [0, 0, 1], axis=1), body.disc)
    moved = motions(
        body, entries_of(body, model.geometry, model.dofs), np.array([[0.0], [0.1], [0.0]])
    )
    away = body.xyz[rim] - [0, 0, 1]
    np.testing.assert_allclose(moved[0, rim], np.cross([0, 0, 0.1], away))
    assert not moved[0, : body.real].any()


def test_sensors_with_a_sign_and_directions_of_their_own():
    turned = [[[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.eye(3)]
    geometry = Geometry([1, 2], [[0, 0, 0], [1, 0, 0]], [[1, 2]], turned)
    body = sensor_body(geometry, ["1:-X", "2:Z"])
    moved = motions(body, entries_of(body, geometry, ["1:-X", "2:Z"]), [[1 + 2j], [3.0]])
    np.testing.assert_allclose(moved[0], [[0, -1 - 2j, 0], [0, 0, 3]])


def test_the_json_decodes_to_what_was_given():
    scene = block_scene()
    data = json.loads(as_json(scene))
    body = scene.bodies[0]
    given = data["bodies"][0]
    np.testing.assert_array_equal(decoded(given["labels"], "<i4"), body.nodes)
    np.testing.assert_allclose(decoded(given["xyz"], "<f4").reshape(-1, 3), body.xyz, rtol=1e-6)
    np.testing.assert_array_equal(decoded(given["faces"], "<i4").reshape(-1, 3), body.faces)
    shape = data["modes"]["layers"][0]["shapes"][1]
    assert shape["im"] is None
    values = decoded(shape["re"]["data"], "<i2").reshape(-1, 3) * shape["re"]["scale"] / 32767
    exact = scene.modes.layers[0].shapes[1]
    np.testing.assert_allclose(values, exact, atol=np.abs(exact).max() / 32767)
    assert [(a["kind"], a["label"], a["vector"]) for a in data["arrows"]] == [
        ("sensor", "15:Z", [0, 0, 1]),
        ("sensor", "45:-Y", [0, -1, 0]),
        ("force", "15:Z", [0, 0, 1]),
    ]


def test_operating_shapes_keep_phase_and_ratio_at_each_line():
    geometry = Geometry([1, 2], [[0, 0, 0], [1, 0, 0]], [[1, 2]])
    body = sensor_body(geometry, ["1:Z", "2:Z"])
    values = np.array([[1e-6, 2e-6j], [3.0 + 4.0j, -1.0]])
    operating = OperatingShapes(
        np.array([10.0, 20.0]),
        "receptance",
        "m/N",
        0,
        entries_of(body, geometry, ["1:Z", "2:Z"]),
        [Reference("1:Z", [OperatingLayer("measured", "measured", "dots", values)])],
    )
    layer = encode_scene(Scene([body], operating=operating))["operating"]["references"][0][
        "layers"
    ][0]
    parts = [
        decoded(layer[p]["data"], "<i2").reshape(2, 2) * layer[p]["scale"] / 32767
        for p in ("re", "im")
    ]
    shape = parts[0] + 1j * parts[1]
    np.testing.assert_allclose(shape[0], [0.5, 1j], atol=1e-4)
    np.testing.assert_allclose(shape[1], [0.6 + 0.8j, -0.2], atol=1e-4)
    curve = decoded(layer["curve"], "<f4")
    np.testing.assert_allclose(curve, np.sqrt(np.mean(np.abs(values) ** 2, axis=1)), rtol=1e-6)


def test_sizes_fall_into_steps():
    found = by_size("Standard deviation", "%", [1.0, 8.0, np.inf, np.nan], list("abcd"))
    assert found.step_of_group == [0, 7, 8, -1]
    assert found.texts[:3] == [
        "a: standard deviation 1 %",
        "b: standard deviation 8 %",
        "c: standard deviation not determined",
    ]
    assert found.steps[0] == ("seq-0", "up to 1")
    log = by_size(
        "x", "", [1.0, 10.0, 256.0], list("abc"), by_row=[[1.0, 256.0, 2.1]], logarithmic=True
    )
    assert log.step_of_group == [0, 3, 7]
    assert log.by_row[0][0] == [0, 7, 1]
    assert by_size("x", "", [0.0, np.nan], list("ab")).step_of_group == [0, -1]


def test_the_legend_has_no_steps_without_sizes():
    """Where nothing is determined, eight steps up to 0 would say nothing."""
    unknown = by_size("Standard deviation", "%", [np.inf, np.nan], list("ab"), logarithmic=True)
    assert unknown.steps == [("same", "not determined")]
    assert unknown.step_of_group == [0, -1]
    zero = by_size("Standard deviation", "%", [0.0, np.inf], list("ab"), logarithmic=True)
    assert zero.steps == [("seq-0", "up to 0"), ("same", "not determined")]
    assert zero.step_of_group == [0, 1]


def test_what_does_not_fit_together_is_refused():
    scene = block_scene()
    with pytest.raises(InputError, match="has 1 groups; the body has 2"):
        dataclasses.replace(scene, colourings=[Colouring("c", "", [("none", "n")], [0], ["t"])])
    with pytest.raises(InputError, match=r"step 3 of 1, from 0"):
        Colouring("c", "", [("none", "n")], [3], ["t"])
    layer = scene.modes.layers[0]
    with pytest.raises(
        InputError,
        match="role 'afterwards' of layer 'model'; expected one of measured, before, after",
    ):
        dataclasses.replace(layer, role="afterwards")
    short = dataclasses.replace(layer, shapes=layer.shapes[:, 1:])
    modes = dataclasses.replace(scene.modes, layers=[short])
    with pytest.raises(InputError, match=r"expected \(s, 42, 3\)"):
        dataclasses.replace(scene, modes=modes)
    with pytest.raises(InputError, match=r"99:Z.*the geometry has no such node"):
        model_scene(block(), responses=["99:Z"])
    with pytest.raises(InputError, match="no geometry"):
        model_body(dataclasses.replace(block(), geometry=None))


def test_hostile_text_stays_text():
    scene = block_scene(title='</script><script>alert(1)</script>"')
    assert "alert(1)</script>" not in as_json(scene)
    assert "<script>alert" not in page(scene)
    frame = html(scene)
    assert frame.startswith('<iframe title="&lt;/script&gt;')
    assert 'sandbox="allow-scripts allow-downloads"' in frame
    assert "<" not in frame.split('srcdoc="')[1].removesuffix('"></iframe>')
