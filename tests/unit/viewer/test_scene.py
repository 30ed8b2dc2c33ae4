"""Scenes by value: positions, skins, groups, motion, and what the arrays of the JSON decode to."""

from __future__ import annotations

import base64
import dataclasses
import json
from itertools import pairwise

import numpy as np
import pytest

import updyn
from updyn.errors import InputError
from updyn.geometry import Geometry
from updyn.settings import FIGURES
from updyn.viewer import (
    Colouring,
    OperatingLayer,
    OperatingShapes,
    Reference,
    Scale,
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
from updyn.viewer.bodies import connect_nodes
from updyn.viewer.colourings import scale_of_changes
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


def test_sizes_have_a_place_on_a_scale_from_zero():
    found = by_size("Standard deviation", "%", [1.0, 8.0, np.inf, np.nan], list("abcd"))
    assert found.texts[:3] == [
        "a: standard deviation 1 %",
        "b: standard deviation 8 %",
        "c: standard deviation not determined",
    ]
    np.testing.assert_allclose(found.scale.of_group, [0.125, 1.0, np.nan, np.nan])
    assert found.steps == [("same", "not determined")]
    assert found.step_of_group == [-1, -1, 0, -1]
    ticks = [(0.0, "0"), (0.25, "2"), (0.5, "4"), (0.75, "6"), (1.0, "8")]
    assert found.scale.ticks == ticks
    assert found.scale.colours[0] == "seq-0"


@pytest.mark.parametrize(
    ("largest", "texts"),
    [
        (7.3, ["0", "2", "4", "6", "8"]),
        (0.31, ["0", "0.1", "0.2", "0.3", "0.4"]),
        (100.0, ["0", "20", "40", "60", "80", "100"]),
    ],
)
def test_the_ticks_of_sizes_are_round_and_end_the_scale(largest, texts):
    scale = by_size("x", "", [largest], ["a"]).scale
    assert [text for _, text in scale.ticks] == texts
    assert scale.of_group[0] == pytest.approx(largest / float(texts[-1]))
    for place, text in scale.ticks:
        assert place == pytest.approx(float(text) / float(texts[-1]))


def test_a_logarithmic_scale_is_even_in_the_logarithm():
    by_row = [[2.0, 50.0, 10.0]]
    found = by_size("x", "", [2.0, 20.0, 50.0], list("abc"), by_row=by_row, logarithmic=True)
    decades = np.log10(50.0 / 2.0)
    np.testing.assert_allclose(found.scale.of_group, [0.0, 1.0 / decades, 1.0])
    np.testing.assert_allclose(found.scale.by_row, [[0.0, 1.0, np.log10(5.0) / decades]])
    assert [text for _, text in found.scale.ticks] == ["2", "5", "10", "20", "50"]
    wide = by_size("x", "", [0.39, 52.0], list("ab"), logarithmic=True).scale
    assert [text for _, text in wide.ticks] == ["0.2", "1", "10", "100"]  # decades come first


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_ticks_keep_their_distance(monkeypatch, factor):
    default = FIGURES.tick_distance
    settings = dataclasses.replace(FIGURES, tick_distance=factor * default)
    monkeypatch.setattr("updyn.viewer.colourings.FIGURES", settings)
    found = by_size("x", "", [0.01, 100.0], list("ab"), logarithmic=True).scale.ticks
    assert min(b[0] - a[0] for a, b in pairwise(found)) >= factor * default
    assert len(found) == {0.5: 13, 1.0: 5, 2.0: 3}[factor]  # four decades
    assert {found[0][1], found[-1][1]} == {"0.01", "100"}


def test_changes_have_no_change_in_the_middle_of_their_scale():
    scale = scale_of_changes([1.0, np.nan, 1.5, 1 / 1.5, 9.0], np.log(1.5))
    np.testing.assert_allclose(scale.of_group, [0.5, np.nan, 1.0, 0.0, 1.0])
    assert scale.colours == (
        *(f"less-{i}" for i in (4, 3, 2, 1)),
        *(f"more-{i}" for i in (1, 2, 3, 4)),
    )
    assert dict(scale.ticks)[0.5] == "0 %"
    assert [text for _, text in scale.ticks] == ["\u221220 %", "0 %", "+20 %", "+50 %"]
    for place, text in scale.ticks:
        change = float(text.removesuffix(" %").replace("\u2212", "-"))
        assert place == pytest.approx(0.5 + 0.5 * np.log1p(change / 100) / np.log(1.5))
    losses = [text for place, text in scale_of_changes([1.0], np.log(11.0)).ticks if place < 0.5]
    assert losses == ["\u221290 %", "\u221280 %", "\u221250 %"]


def test_the_legend_has_no_scale_without_sizes():
    unknown = by_size("Standard deviation", "%", [np.inf, np.nan], list("ab"), logarithmic=True)
    assert unknown.steps == [("same", "not determined")]
    assert unknown.step_of_group == [0, -1]
    assert unknown.scale is None
    zero = by_size("Standard deviation", "%", [0.0, np.inf], list("ab"), logarithmic=True)
    assert zero.scale.ticks == [(0.0, "0")]
    np.testing.assert_array_equal(zero.scale.of_group, [0.0, np.nan])


def test_scale_and_labels_are_encoded():
    scale = Scale(["seq-0", "seq-7"], [(0.0, "0"), (1.0, "1")], [0.25, np.nan], [[1.0, 0.123456]])
    colouring = Colouring("c", "", [], [-1, -1], ["a", "b"], scale=scale, labels=["a +1 %", ""])
    (found,) = json.loads(as_json(block_scene(colourings=[colouring])))["colourings"]
    assert found["labels"] == ["a +1 %", ""]
    assert found["scale"] == {
        "colours": ["seq-0", "seq-7"],
        "ticks": [[0.0, "0"], [1.0, "1"]],
        "of_group": [0.25, None],
        "by_row": [[1.0, 0.1235]],
    }


def test_a_disc_is_connected_to_its_neighbours():
    model = shaft()
    body = connected(Geometry(model.geometry.nodes, model.geometry.xyz), model.dofs.labels)
    assert body.real == 3
    between = body.lines[(body.lines < body.real).all(axis=1)]
    assert between.tolist() == [[0, 1], [1, 2]]
    assert len(body.line_group) == len(body.lines)


def connected(geometry, dofs):
    return connect_nodes(sensor_body(geometry, dofs))


def test_sensors_without_a_line_are_connected_to_their_neighbours():
    beam = Geometry([1, 2, 3, 4], [[0, 0, 0], [1, 0, 0], [2.5, 0, 0], [3, 0.1, 0]])
    labels = [f"{node}:Z" for node in (1, 2, 3, 4)]
    assert connected(beam, labels).lines.tolist() == [[0, 1], [1, 2], [2, 3]]
    # lines of the geometry stay as they are
    traced = Geometry(beam.nodes, beam.xyz, [[1, 3], [2, 4]])
    assert connected(traced, labels).lines.tolist() == [[0, 2], [1, 3]]
    some = Geometry(beam.nodes, beam.xyz, [[1, 2]])
    assert connected(some, labels).lines.tolist() == [[0, 1], [1, 2], [2, 3]]
    # a line that ends at a node without a sensor does not count
    assert connected(traced, labels[:3]).lines.tolist() == [[0, 2], [0, 1], [1, 2]]
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0), indexing="ij")
    xyz = np.stack([x, y, 0.0 * x], -1).reshape(-1, 3)
    grid = connected(Geometry(np.arange(1, 21), xyz), [f"{n}:Z" for n in range(1, 21)]).lines
    length = np.linalg.norm(xyz[grid[:, 0]] - xyz[grid[:, 1]], axis=1)
    np.testing.assert_allclose(length, 1.0)  # a grid without diagonals
    assert len(grid) == 4 * 4 + 5 * 3


@pytest.mark.parametrize(("size", "factor"), [(12, 0.5), (12, 1.0), (24, 1.0), (24, 2.0)])
def test_neighbours_of_a_sensor_are_searched_among_the_nearest_nodes(monkeypatch, size, factor):
    """The neighbour of the first sensor is on the other side than a cluster, and farther away."""
    settings = dataclasses.replace(FIGURES, neighbours=round(factor * FIGURES.neighbours))
    monkeypatch.setattr("updyn.viewer.bodies.FIGURES", settings)
    angle = np.linspace(0.0, 0.3, size)
    cluster = np.stack([np.ones(size), angle, np.zeros(size)], -1)
    xyz = np.concatenate([[[0.0, 0.0, 0.0], [-1.3, 0.0, 0.0]], cluster])
    numbers = np.arange(1, size + 3)
    chain = np.stack([numbers[1:-1], numbers[2:]], -1)  # all but the first have a line
    body = connected(Geometry(numbers, xyz, chain), [f"{node}:Z" for node in numbers])
    assert ([0, 1] in body.lines.tolist()) == (factor * 16 >= size + 1)


def test_what_does_not_fit_together_is_refused():
    scene = block_scene()
    with pytest.raises(InputError, match="has 1 groups; the body has 2"):
        dataclasses.replace(scene, colourings=[Colouring("c", "", [("none", "n")], [0], ["t"])])
    with pytest.raises(InputError, match=r"step 3 of 1, from 0"):
        Colouring("c", "", [("none", "n")], [3], ["t"])
    with pytest.raises(InputError, match=r"place 1.5 on a colour scale; expected 0 to 1"):
        Scale(["seq-0", "seq-7"], [], [1.5])
    for more in ({"labels": ["a", "b"]}, {"scale": Scale(["seq-0", "seq-7"], [], [0.0, 0.0])}):
        with pytest.raises(InputError, match=r"has 2 (labels|places); expected one for each of 1"):
            Colouring("c", "", [], [-1], ["t"], **more)
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
