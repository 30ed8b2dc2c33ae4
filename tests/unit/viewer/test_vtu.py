"""VTU files, read by meshio: cells, shapes, and changes of groups with their standard deviations."""

from __future__ import annotations

from dataclasses import replace

import meshio
import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from viewer_case import block, shaft


def bar() -> updyn.Model:
    """Three springs in a row along Y; the last node has a mass alone."""
    ends = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1]])
    groups = {
        f"part{n + 1}": updyn.Group(
            1e4 * np.outer(end, end), np.diag(np.eye(3)[n]), loss_factor=0.01 * (n + 1)
        )
        for n, end in enumerate(ends)
    }
    xyz = [[0, 0, 0], [0, 1, 0], [0, 2, 0], [0, 3, 0]]
    geometry = updyn.Geometry([1, 2, 3, 4], xyz, [[1, 2], [2, 3], [3, 4]])
    return updyn.Model.from_groups(groups, ["2:Z", "3:Z", "4:Z"], geometry=geometry)


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    start = bar()
    truth = start.scaled({"part2": {"stiffness": 0.8}, "part3": {"mass": 1.2}})
    frf = updyn.response(truth, np.linspace(2, 30, 40), ["2:Z", "4:Z"], ["4:Z"])
    rng = np.random.default_rng(1)
    noise = 1 + 0.01 * (rng.standard_normal(frf.values.shape))
    frf = replace(frf, values=frf.values * noise)
    unknowns = (
        updyn.link(start, "part2.thickness", {"part2.stiffness": 3, "part2.mass": 1})
        + updyn.parameters(start, mass=["part3"])
        + updyn.parameters(start, loss_factor=["part1"])
    )
    return updyn.update(start, frf, unknowns, starts=0)


def read(shapes, path, structure, **more):
    updyn.write_shapes(shapes, path, structure, **more)
    return meshio.read(path)


def test_a_mesh_of_solids(tmp_path):
    model = block()
    modes = updyn.modes(model, 3)
    mesh = read(modes, tmp_path / "block.vtu", model)
    geometry = model.geometry
    nodes = mesh.point_data["node"]
    np.testing.assert_array_equal(mesh.points, geometry.position(nodes))
    cells = mesh.cells_dict
    assert set(cells) == {"line", "triangle"}
    a, b, c = (mesh.points[corner] for corner in cells["triangle"].T)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(4 * 0.4 * 0.1 + 2 * 0.1 * 0.1)
    group = mesh.cell_data_dict["group"]["triangle"]
    middle = ((a + b + c) / 3)[:, 0]
    held = middle == 0.0  # faces without DOFs have no group
    np.testing.assert_array_equal(group, np.where(held, -1, np.where(middle < 0.2, 0, 1)))
    for number in range(3):
        name = f"Mode {number + 1}, {modes.frequency[number]:.6g} Hz, loss factor 0 real"
        labels = [f"{node}:Y" for node in nodes if f"{node}:Y" in modes.dofs.labels]
        at = np.isin(nodes, [int(label.split(":")[0]) for label in labels])
        expected = modes.at(labels)[:, number]
        np.testing.assert_allclose(mesh.point_data[name][at, 1], expected, rtol=1e-12)
        np.testing.assert_array_equal(mesh.point_data[name][~at], 0.0)
    assert len(mesh.point_data) == 4  # no imaginary parts


def test_complex_shapes_at_sensors(tmp_path):
    values = np.array([[1 + 2j, 3j], [-2 + 0j, 1 - 1j]])
    modes = updyn.ModeSet([4.0, 9.0], values, ["2:Z", "4:-Y"])
    mesh = read(modes, tmp_path / "modes.vtu", bar(), select=[1])
    assert mesh.point_data["node"].tolist() == [2, 4]
    assert set(mesh.cells_dict) == {"vertex"}
    zero = [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(mesh.point_data["Mode 2, 9 Hz real"], [zero, [0, -1, 0]])
    np.testing.assert_array_equal(mesh.point_data["Mode 2, 9 Hz imaginary"], [[0, 0, 3], [0, 1, 0]])


def test_rotations_are_vectors(tmp_path):
    modes = updyn.ModeSet([4.0], [[1.0], [0.5], [0.25]], ["2:Z", "2:-RX", "3:RY"])
    mesh = read(modes, tmp_path / "modes.vtu", bar())
    turned = mesh.point_data["Mode 1, 4 Hz rotation real"]
    np.testing.assert_array_equal(turned[:2], [[-0.5, 0, 0], [0, 0.25, 0]])


def test_deviations_of_shapes(tmp_path):
    """Along a tilted axis: the components of the vector; without a direction there is none."""
    tilt = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    axes = [tilt, np.eye(3), np.eye(3), np.eye(3)]
    placed = bar().geometry
    geometry = updyn.Geometry(placed.nodes, placed.xyz, axes=axes)
    std = [[0.5, np.nan], [0.25, np.nan], [0.125, np.nan]]
    modes = updyn.ModeSet([4.0, 5.0], np.ones((3, 2)), ["1:X", "2:Z", "2:RX"], std_shapes=std)
    mesh = read(modes, tmp_path / "modes.vtu", geometry)
    found = mesh.point_data["Mode 1, 4 Hz std"]
    np.testing.assert_allclose(found[:2], [[0.3, 0.4, 0.0], [0.0, 0.0, 0.25]])
    assert np.isnan(mesh.point_data["Mode 2, 5 Hz std"][0]).all()


def test_drive_trains_have_discs(tmp_path):
    model = shaft()
    mesh = read(updyn.modes(model, 2), tmp_path / "shaft.vtu", model)
    assert len(mesh.points) == 3 * 17
    shape = next(v for k, v in mesh.point_data.items() if k.startswith("Mode 2") and "rot" not in k)
    assert np.abs(shape[:3]).max() == 0.0
    assert np.abs(shape[3:, :2]).max() > 0.0


def test_changes_of_groups(tmp_path, result):
    """Factors by hand from the unknowns; standard deviations by central differences."""
    mesh = read(updyn.modes(result.model, 2), tmp_path / "result.vtu", result)
    group = mesh.cell_data_dict["group"]["line"]
    assert sorted(group.tolist()) == [0, 1, 2]
    cells = {name: data["line"][np.argsort(group)] for name, data in mesh.cell_data_dict.items()}
    t, mass, loss = result.values.values()
    np.testing.assert_allclose(cells["stiffness factor"], [1, t**3, 1])
    np.testing.assert_allclose(cells["mass factor"], [1, t, mass])
    np.testing.assert_allclose(cells["loss factor"], [loss, 0.02, 0.03])

    x, step = np.array([t, mass, loss]), 1e-5

    def deviation(name, quantity):
        slopes = []
        for e in np.eye(3) * step:
            high, low = (result.parameters.changes(x + s * e)[name][quantity] for s in (1, -1))
            slopes.append((high - low) / (2 * step))
        return np.sqrt(slopes @ result.covariance @ slopes)

    expected = [np.nan, deviation("part2", "stiffness"), np.nan]
    np.testing.assert_allclose(cells["stiffness factor std"], expected, rtol=1e-6)
    expected = [np.nan, deviation("part2", "mass"), deviation("part3", "mass")]
    np.testing.assert_allclose(cells["mass factor std"], expected, rtol=1e-6)
    assert cells["loss factor std"][0] == pytest.approx(result.std["part1.loss_factor"])


def test_undetermined_changes_have_no_deviation(tmp_path, result):
    covariance = result.covariance.copy()
    covariance[1], covariance[:, 1] = np.inf, np.inf
    open_ = replace(result, covariance=covariance)
    mesh = read(updyn.modes(result.model, 1), tmp_path / "result.vtu", open_)
    data = mesh.cell_data_dict
    order = np.argsort(data["group"]["line"])
    std = data["mass factor std"]["line"][order]
    assert np.isnan(std).tolist() == [True, False, True]


def test_changes_need_the_whole_model(tmp_path, result):
    measured = updyn.ModeSet([3.0], [[1.0], [0.5]], ["2:Z", "3:Z"])
    with pytest.raises(
        OptionError, match=r"changes of groups are drawn on the model.*updyn\.modes"
    ):
        updyn.write_shapes(measured, tmp_path / "a.vtu", result)
    assert not list(tmp_path.iterdir())
    assert "group" not in read(measured, tmp_path / "a.vtu", result.model).cell_data


def test_names_of_groups_are_escaped(tmp_path):
    model = bar()
    groups = dict(zip(["a--b", "c<d>&", "é"], model.groups.values(), strict=True))
    named = updyn.Model(groups, model.dofs, model.geometry)
    read(updyn.modes(named, 1), tmp_path / "a.vtu", named)
    text = (tmp_path / "a.vtu").read_text(encoding="utf-8")
    assert "<!-- groups: 0 a- -b, 1 c<d>&, 2 é -->" in text
