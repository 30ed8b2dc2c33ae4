"""Shapes in universal files: datasets 55 and 2414 with a geometry, read by updyn and by pyuff."""

from __future__ import annotations

import numpy as np
import pytest
import pyuff

import updyn
from updyn.errors import DataError, FormatError, InputError, OptionError, UpdynWarning

#: pyuff leaves files open.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

LABELS = ["3:X", "3:-Z", "11:Y", "2:Z"]
TILT = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def geometry(axes=None) -> updyn.Geometry:
    xyz = [[0.0, 0.1, 0.2], [1.0, 0.0, 0.0], [2.0, 0.0, 1.0]]
    return updyn.Geometry([3, 11, 2], xyz, [[3, 11], [11, 2]], axes)


def shape(n: int = 2, *, complex_: bool = True) -> np.ndarray:
    rng = np.random.default_rng(5)
    values = rng.standard_normal((4, n)) + 1j * complex_ * rng.standard_normal((4, n))
    return values.round(4)


def modes(**more) -> updyn.ModeSet:
    given = {"loss_factor": [0.02, 0.011], "scaled": True} | more
    return updyn.ModeSet([12.5, 31.25], shape(), LABELS, **given)


def frf(references=("3:X",)) -> updyn.FRF:
    freq = np.array([5.0, 7.5, 10.0])
    values = np.stack([shape(3).T] * len(references), axis=-1)
    return updyn.FRF(freq, values, LABELS, references, "accelerance", geometry=geometry())


def sets_of(path, number):
    return [s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == number]


@pytest.mark.parametrize("dataset", [55, 2414])
@pytest.mark.parametrize("real", [True, False])
def test_modes_and_geometry_come_back(tmp_path, dataset, real):
    given = modes(std_shapes=np.full((4, 2), 0.25), quality=[0.5, 0.75], std_frequency=0.1)
    if real:
        given = updyn.ModeSet([12.5, 31.25], shape(complex_=False), LABELS, [0.02, 0.011])
    path = tmp_path / "modes.unv"
    updyn.write_modes(given, path, geometry=geometry(), dataset=dataset)
    found = updyn.read_modes(path)
    np.testing.assert_allclose(found.frequency, given.frequency, rtol=1e-5)
    np.testing.assert_allclose(found.loss_factor, given.loss_factor, rtol=1e-4)
    np.testing.assert_array_equal(found.scaled, given.scaled)
    np.testing.assert_array_equal(found.quality, given.quality)
    match = found.dofs.match(given.dofs)
    np.testing.assert_allclose(
        found.shapes[match.index] * match.sign[:, None], given.shapes, atol=1e-4
    )
    if not real:
        np.testing.assert_allclose(found.std_shapes, 0.25, rtol=1e-4)
    placed = updyn.read_geometry(path)
    np.testing.assert_array_equal(placed.xyz, geometry().xyz)
    np.testing.assert_array_equal(placed.lines, geometry().lines)


def test_a_file_without_geometry_is_that_of_write_modes(tmp_path):
    updyn.write_modes(modes(), tmp_path / "a.unv")
    updyn.write_shapes(modes(), tmp_path / "b.unv", geometry())
    shapes_alone = (tmp_path / "a.unv").read_text().split("    55\n", 1)[1]
    assert shapes_alone == (tmp_path / "b.unv").read_text().split("    55\n", 1)[1]


def test_pyuff_reads_modes(tmp_path):
    path = tmp_path / "modes.unv"
    updyn.write_shapes(modes(), path, geometry())
    for number, one in enumerate(sets_of(path, 55)):
        assert one["analysis_type"] == 3
        assert one["node_nums"].astype(int).tolist() == [3, 11, 2]
        values = shape()[:, number]
        np.testing.assert_allclose(one["r1"], [values[0], 0, 0], atol=1e-5)
        np.testing.assert_allclose(one["r2"], [0, values[2], 0], atol=1e-5)
        np.testing.assert_allclose(one["r3"], [-values[1], 0, values[3]], atol=1e-5)
        omega = 2 * np.pi * modes().frequency[number]
        assert abs(one["eig"]) == pytest.approx(omega, rel=1e-5)
    (nodes,) = sets_of(path, 2411)
    np.testing.assert_allclose(np.array([nodes["x"], nodes["y"], nodes["z"]]).T, geometry().xyz)


@pytest.mark.parametrize("dataset", [55, 2414])
def test_pyuff_reads_operating_shapes(tmp_path, dataset):
    path = tmp_path / "shape.unv"
    updyn.write_shapes(frf(), path, freq=[7.4, 10.0], dataset=dataset)
    found = sets_of(path, dataset)
    assert [one["analysis_type"] for one in found] == [5, 5]
    name = "freq" if dataset == 55 else "frequency"
    assert [one[name] for one in found] == pytest.approx([7.5, 10.0])
    columns = ("r1", "r2", "r3") if dataset == 55 else ("x", "y", "z")
    for number, one in enumerate(found):
        values = shape(3)[:, number + 1]
        rows = [np.asarray(one[column]) for column in columns]
        np.testing.assert_allclose(rows[0], [values[0], 0, 0], atol=1e-5)
        np.testing.assert_allclose(rows[2], [-values[1], 0, values[3]], atol=1e-5)


def test_local_directions_become_global(tmp_path):
    """A node with tilted axes: the vector in global components, as the format requires."""
    path = tmp_path / "modes.unv"
    given = updyn.ModeSet([10.0], [[2.0], [1.0]], ["3:X", "11:Y"])
    updyn.write_shapes(given, path, geometry([TILT, np.eye(3), np.eye(3)]))
    found = updyn.read_modes(path)
    assert found.dofs.labels == ["3:X", "3:Y", "11:Y"]
    np.testing.assert_allclose(found.shapes[:, 0], [1.2, 1.6, 1.0], rtol=1e-5)
    np.testing.assert_allclose(updyn.read_geometry(path).axes[0], TILT)


def test_deviations_along_local_directions_are_lost_with_a_warning(tmp_path):
    given = updyn.ModeSet([10.0], [[2.0]], ["3:X"], std_shapes=[[0.1]])
    with pytest.warns(UpdynWarning, match="mode 1 are along local directions"):
        updyn.write_shapes(given, tmp_path / "a.unv", geometry([TILT] * 3))


def test_computed_modes_and_their_selection(tmp_path):
    path = tmp_path / "modes.unv"
    group = updyn.Group(np.array([[2e4, -1e4], [-1e4, 1e4]]), np.eye(2), loss_factor=0.03)
    model = updyn.Model.from_groups({"a": group}, ["3:Z", "11:Z"], geometry=geometry())
    computed = updyn.modes(model, 2)
    updyn.write_shapes(computed, path, model, select=[1])
    found = updyn.read_modes(path)
    assert found.frequency == pytest.approx(computed.frequency[1:], rel=1e-5)
    np.testing.assert_allclose(found.shapes[:, 0], computed.shapes[:, 1], rtol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "more", "error", "message"),
    [
        ((modes(),), {}, OptionError, "structure: shapes need the positions"),
        ((modes(), geometry()), {"freq": 3.0}, OptionError, "freq: applies to FRFs only"),
        ((updyn.ModeSet([3.0]), geometry()), {}, DataError, "natural frequencies only"),
        ((frf(),), {}, OptionError, "freq: expected the frequency of an operating shape, 5 to 10"),
        ((frf(),), {"freq": 11.0}, DataError, "11 Hz is outside the lines, 5 to 10 Hz"),
        ((frf(),), {"freq": 5.0, "select": [0]}, OptionError, "select: chooses modes"),
        ((frf(("3:X", "2:Z")),), {"freq": 5.0}, OptionError, "one of 3:X, 2:Z"),
        ((frf(),), {"freq": 5.0, "reference": "3:Y"}, OptionError, "did you mean '3:X'"),
        ((modes(), geometry()), {"dataset": 56}, OptionError, "expected 55 or 2414"),
        ((modes(), geometry()), {"datset": 55}, OptionError, "did you mean 'dataset'"),
        ((modes(), geometry()), {"select": [2]}, DataError, "numbers from 0 to 1"),
        (("shape", geometry()), {}, OptionError, "expected a ModeSet, Modes or an FRF, found str"),
        (
            (modes().renamed(["3:X", "4:Z", "11:Y", "2:Z"]), geometry()),
            {},
            InputError,
            "node 4 has no position",
        ),
    ],
)
def test_refused(tmp_path, arguments, more, error, message):
    path = tmp_path / "a.unv"
    shapes, *structure = arguments
    with pytest.raises(error, match=message):
        updyn.write_shapes(shapes, path, *structure, **more)
    assert not path.exists()


def test_formats_without_shapes_are_refused(tmp_path):
    with pytest.raises(FormatError, match="can write_shapes"):
        updyn.write_shapes(modes(), tmp_path / "a.csv", geometry())
    with pytest.raises(OptionError, match="no option 'geometry'"):
        updyn.write_modes(updyn.ModeSet([3.0]), tmp_path / "a.csv", geometry=geometry())
